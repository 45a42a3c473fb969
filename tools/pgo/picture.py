"""The picture people put in papers: how far above the optimum each method is, against the bytes it has sent."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..common.figures import FAINT, colour_of, dress, saved_figure
from .curves import Curve

_FLOOR = 1e-7
"""Gaps below it are drawn on the edge: the optimum is known to about that."""


def draw_convergence(made: Sequence[Curve], title: str, path: Path) -> None:
    """Payload on the left, everything sent on the right; a dot where a method stops by itself."""
    with saved_figure(path, (11.0, 4.4)) as figure:
        for k, (name, label) in enumerate((("payload", "bytes of poses"), ("wire", "bytes sent"))):
            axes = figure.add_subplot(1, 2, k + 1)
            for number, curve in enumerate(made):
                x, y = getattr(curve, name), [max(gap, _FLOOR) for gap in curve.gaps]
                ends = [len(x) - 1] if curve.end else []
                axes.plot(x, y, "-o", ms=6, markevery=ends, color=colour_of(number), lw=1.6, label=curve.method)
            for gap in (1e-2, 1e-4):
                axes.axhline(gap, color=FAINT, lw=0.8, ls=":")
                axes.text(
                    1.0,
                    gap,
                    f"{100 * gap:g} % ",
                    transform=axes.get_yaxis_transform(),
                    ha="right",
                    va="bottom",
                    fontsize=8,
                    color=FAINT,
                )
            axes.set_xscale("log")
            axes.set_yscale("log")
            dress(axes, "", label, "cost above the optimum, share")
        figure.axes[0].legend()
        figure.suptitle(title, x=0.01, ha="left")
