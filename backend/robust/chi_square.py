"""Quantiles of the chi-square distribution, by the special functions themselves: ``scipy.stats`` takes a second to
import."""

from __future__ import annotations

from scipy.special import chdtri, gammaincinv


def below(probability: float, freedom: float) -> float:
    """What a squared distance of ``freedom`` degrees stays below with this probability."""
    return 2.0 * float(gammaincinv(freedom / 2.0, probability))


def exceeded(probability: float, freedom: float) -> float:
    """What it exceeds with this probability: exact for small ones."""
    return float(chdtri(freedom, probability))
