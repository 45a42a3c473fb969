"""Boxes, arrows and lifelines as SVG text: enough for the diagrams of the documents, and the same bytes each time."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

INK, FAINT, PAPER, BOX = "#1f2933", "#66727f", "#ffffff", "#eef2f6"
BLUE, ORANGE, GREEN, RED = "#0072b2", "#b35900", "#007a5e", "#a33b00"

_MARKER = (
    '<marker id="{name}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto">'
    '<path d="M 0 0 L 10 5 L 0 10 z" fill="{colour}"/></marker>'
)
_COLOURS = (INK, FAINT, BLUE, ORANGE, GREEN, RED)


class Drawing:
    """A white sheet of ``width`` x ``height`` pixels."""

    def __init__(self, width: int, height: int, title: str) -> None:
        self.size = width, height
        self.title = title
        self._parts: list[str] = []

    def text(
        self,
        x: float,
        y: float,
        words: str,
        colour: str = INK,
        anchor: str = "middle",
        size: int = 13,
        over: bool = False,
    ) -> None:
        """One line; ``y`` is its baseline; ``over``: on a line, which is covered around the letters."""
        halo = f'stroke="{PAPER}" stroke-width="4" stroke-linejoin="round" paint-order="stroke"' if over else ""
        style = f'fill="{colour}" font-size="{size}" text-anchor="{anchor}" {halo}'.rstrip()
        self._parts.append(f'<text x="{x:g}" y="{y:g}" {style}>{escape(words)}</text>')

    def box(self, x: float, y: float, words: str, colour: str = INK, width: float = 108, fill: str = BOX) -> None:
        """A rounded box with its centre at ``(x, y)``; ``\\n`` in ``words`` begins a new line."""
        lines = words.split("\n")
        height = 18 + 16 * len(lines)
        place = f'x="{x - width / 2:g}" y="{y - height / 2:g}" width="{width:g}" height="{height:g}" rx="7"'
        self._parts.append(f'<rect {place} fill="{fill}" stroke="{colour}" stroke-width="1.5"/>')
        for k, line in enumerate(lines):
            self.text(x, y + 5 + 16 * (k - (len(lines) - 1) / 2), line, colour)

    def line(self, points: Sequence[tuple[float, float]], colour: str = INK, head: bool = True, dash: str = "") -> None:
        """A line through ``points``, with an arrow head at its end."""
        path = " ".join(f"{x:g},{y:g}" for x, y in points)
        end = f' marker-end="url(#{_name(colour)})"' if head else ""
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.5"{dashes}{end}/>')

    def svg(self) -> str:
        """The file's text."""
        width, height = self.size
        markers = "".join(_MARKER.format(name=_name(colour), colour=colour) for colour in _COLOURS)
        head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}"'
        font = 'font-family="DejaVu Sans, Helvetica, Arial, sans-serif" role="img"'
        paper = f'<rect width="{width}" height="{height}" fill="{PAPER}"/>'
        body = "\n".join(self._parts)
        title = f"<title>{escape(self.title)}</title>"
        return f"{head} {font}>\n{title}\n<defs>{markers}</defs>\n{paper}\n{body}\n</svg>\n"


class SequenceDrawing(Drawing):
    """Messages between participants, time running down."""

    def __init__(self, participants: Sequence[str], rows: int, title: str, apart: int = 250) -> None:
        self._x = [130 + apart * k for k in range(len(participants))]
        self._y = 64
        super().__init__(self._x[-1] + 130, 84 + 36 * rows, title)
        for x, name in zip(self._x, participants, strict=True):
            self.line([(x, 44), (x, self.size[1] - 14)], FAINT, head=False, dash="4 4")
            self.box(x, 26, name, width=150)

    def message(self, sender: int, recipient: int, words: str, colour: str) -> None:
        """An arrow from one lifeline to another."""
        self._y += 36
        a, b = self._x[sender], self._x[recipient]
        edge = -4 if b > a else 4
        self.line([(a, self._y), (b + edge, self._y)], colour)
        self.text((a + b) / 2, self._y - 7, words, colour, size=12, over=True)

    def note(self, participant: int, words: str) -> None:
        """What a participant does by itself."""
        self._y += 36
        self.box(self._x[participant], self._y - 4, words, FAINT, width=230, fill=PAPER)


def _name(colour: str) -> str:
    return f"head-{colour.lstrip('#')}"
