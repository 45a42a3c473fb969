"""Compiling kernels where the user sees it: once on a machine, as a task of its own."""

from __future__ import annotations

from collections.abc import Sequence

from maslam._kernels import TypedKernel, make_ready

from .progress import Progress, counter

COMPILING = "compiling kernels, once"


def compile_for(kernels: Sequence[TypedKernel], progress: Progress) -> None:
    """Make ``kernels`` ready; a task of ``progress`` where numba's cache lacks some."""
    make_ready(kernels, counter(progress, COMPILING))
