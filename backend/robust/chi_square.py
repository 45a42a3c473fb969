"""Quantiles of the chi-square distribution, by the special functions themselves: ``scipy.stats`` takes a second to
import."""

from __future__ import annotations

from scipy.special import chdtri, gammaincinv


def below(probability: float, freedom: float) -> float:
    """Quantile of chi-square with ``freedom`` degrees: the squared distance not exceeded with this probability."""
    return 2.0 * float(gammaincinv(freedom / 2.0, probability))


def exceeded(probability: float, freedom: float) -> float:
    """Upper quantile of chi-square with ``freedom`` degrees: the squared distance exceeded with this probability, exact
    for small ones."""
    return float(chdtri(freedom, probability))
