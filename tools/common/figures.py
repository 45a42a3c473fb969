"""The one way to draw a chart: matplotlib in the house's style, saved to a file or as SVG inside a page."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

from maslam._atomic import replacing

from .drawing_folder import drawing_folder
from .errors import UsageError
from .logs import without_warnings_of

# Okabe and Ito's colours, distinguishable for colour-blind readers, without the yellow that vanishes on white.
PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#6A51A3", "#8C6D31")
DASHES = ((), (6, 3), (2, 3), (8, 3, 2, 3))  # points drawn and left out, when the colours are used up
INK, FAINT, GRID, FRAME, TRUTH = "#22303c", "#6b7a89", "#e4e9ee", "#d5dde4", "#b8c2cc"
STYLE: Any = {
    "font.size": 9,
    "text.color": INK,
    "axes.titlesize": 10,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.labelcolor": FAINT,
    "axes.edgecolor": FRAME,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "legend.labelcolor": INK,
    "lines.linewidth": 1.6,
    "lines.scale_dashes": False,
    "path.simplify_threshold": 0.3,
    "svg.hashsalt": "maslam",
}
_DPI = 110


def colour_of(index: int) -> str:
    """The colour of agent or series ``index``."""
    return PALETTE[index % len(PALETTE)]


def dash_of(index: int) -> tuple[int, ...]:
    """Its line pattern: solid, which is empty, for the first round of colours."""
    return DASHES[index // len(PALETTE) % len(DASHES)]


def style_of(index: int) -> dict[str, Any]:
    """Colour and line pattern of series ``index``, as matplotlib's ``plot`` takes them."""
    return {"color": colour_of(index), "dashes": dash_of(index) or (None, None)}


PICTURES = (".png", ".svg", ".pdf")


def check_picture(path: Path | None) -> None:
    """UsageError where ``--plot`` names a file of no kind that can be drawn: before the work, not after it."""
    if path is not None and path.suffix not in PICTURES:
        raise UsageError(f"--plot {path}: the name must end in {', '.join(PICTURES)}")


@contextmanager
def house_figure(inches: tuple[float, float]) -> Iterator[Any]:
    """A matplotlib figure (width, height) to draw in; drawn and saved inside the block, since the style ends there."""
    with without_warnings_of("matplotlib"):  # where it keeps what it knows of fonts matters to nobody
        import matplotlib
        from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        yield Figure(figsize=inches, facecolor="white", layout="constrained")


@contextmanager
def saved_figure(path: Path, inches: tuple[float, float], dpi: int = _DPI) -> Iterator[Any]:
    """A figure to draw in, written to ``path`` at the end, its kind by the name's ending: the same bytes for the same
    drawing.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with drawing_folder(path.parent), house_figure(inches) as figure:
        yield figure
        undated = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
        with replacing(path) as part:
            figure.savefig(part, format=path.suffix[1:], dpi=dpi, metadata=undated.get(path.suffix))


def dress(axes: Any, title: str = "", x: str = "", y: str = "") -> None:
    """Title, labels and a grid."""
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(visible=True)


def plain_powers(axis: Any) -> None:
    """Plain numbers on a logarithmic axis: 1, 2, 5, 10, ..."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def tip(text: str) -> str:
    """An artist's ``gid`` that becomes the words a page shows under the pointer."""
    return f"tip:{text}"


def inline_svg(figure: Any, label: str) -> str:
    """The figure as an ``<svg>`` element for a page, without addresses and fonts of its own; ``label`` is what a screen
    reader says. Coordinates are cut to a tenth of a point; what lies outside its axes is drawn all the same.
    """
    import matplotlib

    buffer = io.StringIO()
    for part in (figure, *figure.axes):
        part.patch.set_visible(False)
    for line in (line for axes in figure.axes for line in axes.lines):
        line.get_path().should_simplify = True  # matplotlib leaves lines of less than 128 points as they are
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg")
    body = re.split(r"<svg[^>]*>", buffer.getvalue(), maxsplit=1)[1]
    width, height = (72 * inches for inches in figure.get_size_inches())
    start = f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(label, quote=True)}">'
    for pattern, replacement in _COMPACT:
        body = re.sub(pattern, replacement, body, flags=re.DOTALL)
    marks = dict(re.findall(r'<path id="(\w+)" d="([^"]*)"', body))
    body = re.sub(r"<defs>.*?</defs>", "", body)
    return start + re.sub(_MARK, lambda mark: f'd="{marks[mark[1]]}" transform="translate({mark[2]} {mark[3]})"', body)


def _shorter(geometry: re.Match[str]) -> str:
    text = re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.1f}".removesuffix(".0"), geometry[0])
    return re.sub(r"\s*([MLCQz]|$)\s*", r"\1", text)


_COMPACT: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    (r"<metadata>.*?</metadata>|<!--.*?-->|<style.*?</style>|<clipPath.*?</clipPath>", ""),
    (r' clip-path="[^"]*"| transform="rotate\(-0 [^"]*"|font-family: [^;"]*;? ?', ""),
    (r'(?<= d=")[^"]*|(?<= [xy]=")[^"]*', _shorter),
    (r'(?<= style=")[^"]*', lambda style: re.sub(r"([:;]) ", r"\1", style[0])),
    (r'<g id="tip:([^"]*)">', r"<g><title>\1</title>"),
    (r'<g id="[^"]*">', "<g>"),
    (r">\s+<", "><"),
    (r'<g id="[^"]*"/>|^\s+|\s+$', ""),
    (r"<use ", "<path "),
)
"""What matplotlib writes for files and a page does without."""
_MARK = r'xlink:href="#(\w+)" x="([^"]*)" y="([^"]*)"'
"""A shape drawn by its id, which only one chart of a page could have."""
