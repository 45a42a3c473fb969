"""Charts as SVG text: small, sharp at any size, the same bytes for the same data, and no library to load."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Okabe and Ito's colours, told apart by colour-blind readers, without the yellow that vanishes on white.
PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#6A51A3", "#8C6D31")
DASHES = ("", "6 3", "2 3", "8 3 2 3")  # when the colours are used up
INK, FAINT, GRID, FRAME = "#22303c", "#6b7a89", "#e4e9ee", "#d5dde4"
MAX_VERTICES = 3000  # of one line: beyond this a screen shows no more


def colour_of(index: int) -> str:
    """The colour of agent or series ``index``."""
    return PALETTE[index % len(PALETTE)]


def dash_of(index: int) -> str:
    """Its line pattern: solid for the first round of colours."""
    return DASHES[index // len(PALETTE) % len(DASHES)]


def nice_ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Round values (1, 2 or 5 times a power of ten) from ``low`` to ``high``, about ``count`` of them."""
    span = high - low
    if not math.isfinite(span) or span <= 0:
        return [low]
    power = 10.0 ** math.floor(math.log10(span / count))
    step = next((m * power for m in (1, 2, 5) if span / (m * power) <= count), 10 * power)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def format_tick(value: float) -> str:
    """Short text of an axis value: 1500000 is 1.5M."""
    for limit, unit in ((1e9, "G"), (1e6, "M"), (1e4, "k")):
        if abs(value) >= limit:
            scaled = value / {"k": 1e3}.get(unit, limit)
            return f"{scaled:g}{unit}"
    return f"{0.0 if abs(value) < 1e-12 else value:g}"


@dataclass
class Plot:
    """One pair of axes. Data ranges are ``x`` and ``y`` (low, high); ``equal`` widens one so that a metre is a metre
    both ways.
    """

    width: int
    height: int
    x: tuple[float, float]
    y: tuple[float, float]
    x_label: str = ""
    y_label: str = ""
    equal: bool = False
    frame: bool = True
    margins: tuple[int, int, int, int] = (12, 14, 40, 58)  # top, right, bottom, left; pixels
    _parts: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.x, self.y = _widened(self.x), _widened(self.y)
        if self.equal:
            self.x, self.y = self._equal_ranges()

    def line(
        self,
        xs: ArrayLike,
        ys: ArrayLike,
        colour: str,
        title: str = "",
        width: float = 1.8,
        dash: str = "",
        opacity: float = 1.0,
    ) -> None:
        """A line through the points; it breaks where a value is NaN."""
        path = _path(*self._pixels(xs, ys))
        if path:
            style = f' stroke-dasharray="{dash}"' if dash else ""
            style += f' stroke-opacity="{opacity:g}"' if opacity < 1 else ""
            attributes = (
                f'd="{path}" fill="none" stroke="{colour}" stroke-width="{width:g}" stroke-linejoin="round"{style}'
            )
            self._add("path", attributes, title)

    def area(self, xs: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str, title: str = "") -> None:
        """The band between two lines."""
        u, top = self._pixels(xs, high)
        _, bottom = self._pixels(xs, low)
        corners = " ".join(
            f"{a:.1f},{b:.1f}" for a, b in [*zip(u, top, strict=True), *zip(u[::-1], bottom[::-1], strict=True)]
        )
        self._add("polygon", f'points="{corners}" fill="{colour}" fill-opacity="0.85"', title)

    def segments(self, a: ArrayLike, b: ArrayLike, colour: str, width: float = 1.0, opacity: float = 0.6) -> None:
        """Straight links between the points ``a`` and ``b``, ``(N, 2)``."""
        ends = [
            self._pixels(p[:, 0], p[:, 1])
            for p in (np.asarray(a, float).reshape(-1, 2), np.asarray(b, float).reshape(-1, 2))
        ]
        path = "".join(
            f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}" for x0, y0, x1, y1 in zip(*ends[0], *ends[1], strict=True)
        )
        if path:
            self._add(
                "path",
                f'd="{path}" stroke="{colour}" stroke-width="{width:g}" stroke-opacity="{opacity:g}" fill="none"',
            )

    def mark(self, x: float, y: float, colour: str, radius: float = 4.0, title: str = "", text: str = "") -> None:
        """A disc, with a word beside it."""
        (u,), (v,) = self._pixels([x], [y])
        self._add(
            "circle",
            f'cx="{u:.1f}" cy="{v:.1f}" r="{radius:g}" fill="{colour}" stroke="#fff" stroke-width="1.2"',
            title,
        )
        if text:
            style = (
                f'font-size="12" font-weight="600" fill="{colour}" paint-order="stroke" stroke="#fff" stroke-width="3"'
            )
            self._parts.append(f'<text x="{u + 7:.1f}" y="{v - 5:.1f}" {style}>{escape(text)}</text>')

    def vertical(self, xs: Iterable[float], colour: str, title: str = "") -> None:
        """Thin lines over the whole height, at moments that matter."""
        _, top, _, bottom = self._box()
        for x in xs:
            (u,), _ = self._pixels([x], [self.y[0]])
            self._add("path", f'd="M{u:.1f} {top}V{bottom}" stroke="{colour}" stroke-dasharray="2 3"', title)

    def svg(self, label: str) -> str:
        """The finished chart; ``label`` is what a screen reader says."""
        head = f'<svg viewBox="0 0 {self.width} {self.height}" role="img" aria-label="{escape(label, quote=True)}">'
        return "".join([head, *(self._axes() if self.frame else []), *self._parts, "</svg>"])

    def _add(self, element: str, attributes: str, title: str = "") -> None:
        inner = f"><title>{escape(title)}</title></{element}>" if title else "/>"
        self._parts.append(f"<{element} {attributes}{inner}")

    def _box(self) -> tuple[int, int, int, int]:
        """Left, top, right, bottom of the axes, pixels."""
        top, right, bottom, left = self.margins
        return left, top, self.width - right, self.height - bottom

    def _equal_ranges(self) -> tuple[tuple[float, float], tuple[float, float]]:
        left, top, right, bottom = self._box()
        scale = min((right - left) / (self.x[1] - self.x[0]), (bottom - top) / (self.y[1] - self.y[0]))
        half_x, half_y = (right - left) / scale / 2, (bottom - top) / scale / 2
        middle_x, middle_y = sum(self.x) / 2, sum(self.y) / 2
        return (middle_x - half_x, middle_x + half_x), (middle_y - half_y, middle_y + half_y)

    def _pixels(self, xs: ArrayLike, ys: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        left, top, right, bottom = self._box()
        u = left + (np.asarray(xs, float) - self.x[0]) / (self.x[1] - self.x[0]) * (right - left)
        v = bottom - (np.asarray(ys, float) - self.y[0]) / (self.y[1] - self.y[0]) * (bottom - top)
        return u, v

    def _axes(self) -> list[str]:
        left, top, right, bottom = self._box()
        parts = []
        for x in nice_ticks(*self.x, max(2, (right - left) // 90)):
            (u,), _ = self._pixels([x], [0.0])
            parts.append(f'<path d="M{u:.1f} {top}V{bottom}" stroke="{GRID}"/>')
            parts.append(_text(u, bottom + 16, format_tick(x), "middle"))
        for y in nice_ticks(*self.y, max(2, (bottom - top) // 50)):
            _, (v,) = self._pixels([0.0], [y])
            parts.append(f'<path d="M{left} {v:.1f}H{right}" stroke="{GRID}"/>')
            parts.append(_text(left - 7, v + 4, format_tick(y), "end"))
        parts.append(_text((left + right) / 2, self.height - 6, self.x_label, "middle"))
        turn = f' transform="rotate(-90 13 {(top + bottom) / 2:.1f})"'
        parts.append(_text(13, (top + bottom) / 2, self.y_label, "middle", turn))
        return parts


def legend(entries: Sequence[tuple[str, str, str]]) -> str:
    """HTML of a legend: ``(name, colour, dash)`` each."""
    items = []
    for name, colour, dash in entries:
        stroke = f'stroke="{colour}" stroke-width="3"' + (f' stroke-dasharray="{dash}"' if dash else "")
        items.append(f'<span><svg width="26" height="10"><path d="M1 5H25" {stroke}/></svg>{escape(name)}</span>')
    return f'<div class="legend">{"".join(items)}</div>'


def _text(x: float, y: float, text: str, anchor: str, more: str = "") -> str:
    style = f'text-anchor="{anchor}" font-size="11" fill="{FAINT}"'
    return f'<text x="{x:.1f}" y="{y:.1f}" {style}{more}>{escape(text)}</text>'


def _path(u: NDArray[np.float64], v: NDArray[np.float64]) -> str:
    """SVG path data: a new stroke after each gap (NaN)."""
    keep = slice(None, None, max(1, -(-len(u) // MAX_VERTICES)))
    words, drawing = [], False
    for a, b in zip(u[keep], v[keep], strict=True):
        if math.isfinite(a) and math.isfinite(b):
            words.append(f"{'L' if drawing else 'M'}{a:.1f} {b:.1f}")
        drawing = math.isfinite(a) and math.isfinite(b)
    return "".join(words)


def _widened(limits: tuple[float, float]) -> tuple[float, float]:
    """A range of some length, also where all values are one."""
    low, high = (float(v) for v in limits)
    if not (math.isfinite(low) and math.isfinite(high)):
        return 0.0, 1.0
    return (low, high) if high > low else (low - 0.5, high + 0.5)
