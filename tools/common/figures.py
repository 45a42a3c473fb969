"""Plots in the house's style, for every command that draws one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .svg import FAINT, FRAME, GRID, INK

_DPI = 110


@contextmanager
def saved_figure(path: Path, inches: tuple[float, float]) -> Iterator[Any]:
    """A matplotlib figure to draw in, written to ``path`` at the end: the same bytes for the same drawing."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context({"svg.hashsalt": "maslam", "font.size": 9}):
        figure = plt.figure(figsize=inches, facecolor="white", layout="constrained")
        try:
            yield figure
            path.parent.mkdir(parents=True, exist_ok=True)
            undated = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
            figure.savefig(path, dpi=_DPI, metadata=undated.get(path.suffix))
        finally:
            plt.close(figure)


def dress(axes: Any, title: str, x: str, y: str) -> None:
    """Title and labels, in the house's colours."""
    if title:
        axes.set_title(title, fontsize=10, color=INK, loc="left")
    axes.set_xlabel(x, color=FAINT)
    axes.set_ylabel(y, color=FAINT)
    axes.tick_params(colors=FAINT, labelsize=8)
    axes.grid(color=GRID)
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set_color(FRAME)


def plain_powers(axis: Any) -> None:
    """Plain numbers on a logarithmic axis: 1, 2, 5, 10, ..."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
