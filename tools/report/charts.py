"""The charts of a run: maps, errors and bytes, drawn on axes for every picture that has them and as a report's SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.figures import FAINT, INK, TRUTH, colour_of, dress, house_figure, inline_svg, style_of, tip
from ..common.plane import Array, plane_of
from .run_data import RunData

OPERATIONS = {
    "dvpr": "place queries",
    "relpose": "verification",
    "dopt": "optimisation",
    "mapmerge": "map exchange",
    "negotiation": "negotiation",
}
OPERATION_COLOUR = dict(zip(OPERATIONS, ("#56B4E9", "#0072B2", "#D55E00", "#009E73", "#8d99a6"), strict=True))
_WIDE, _HALF, _SMALL = 7.2, (4.8, 2.8), (2.7, 2.1)  # inches, which a page stretches to the space there is
_TALLEST, _FLATTEST = 0.62, 0.3  # height of a map over its width


@dataclass(frozen=True)
class Path2D:
    """One line on a map: ``xy`` ``(N, 2)``; ``index`` chooses the colour; ``faint`` draws it thin (a copy of
    another's map).
    """

    name: str
    xy: Array
    index: int
    faint: bool = False


@dataclass(frozen=True)
class TopView:
    """Contents of a map: ``paths``, the true ones ``truths`` ``(N, 2)`` and ``links`` ``(M, 2, 2)`` between matched
    places.
    """

    paths: Sequence[Path2D]
    truths: Sequence[Array]
    links: Array = field(default_factory=lambda: np.zeros((0, 2, 2)))


def axes_of(run: RunData, members: Sequence[int]) -> list[int]:
    """The plane of a map of ``members``: that of the truth where it is known how they stand to it."""
    aligned = all(run.is_aligned(i) for i in members)
    truths = [agent.truth.centres for agent in run.agents if agent.truth is not None and aligned]
    return list(plane_of(np.concatenate([np.zeros((0, 3)), *(truths or [run.in_world[i] for i in members])])))


def top_view(run: RunData, members: Sequence[int]) -> TopView:
    """The agents ``members`` in the world, or in the frame that they share, with the matches that they have asked
    for."""
    axes, agents = axes_of(run, members), [run.agents[i] for i in members]
    ends = []
    for row in run.accepted:
        pair = [run.position_at(int(row[f"{end}_agent"]), int(row[f"{end}_stamp_ns"])) for end in ("query", "match")]
        if int(row["query_agent"]) in members and pair[0] is not None and pair[1] is not None:
            ends.append([pair[0][axes], pair[1][axes]])
    return TopView(
        [Path2D(agent.name, run.in_world[agent.index][:, axes], agent.index) for agent in agents],
        [agent.truth.centres[:, axes] for agent in agents if agent.truth is not None and run.is_aligned(agent.index)],
        np.array(ends).reshape(-1, 2, 2),
    )


def draw_map(axes: Any, view: TopView, width: float = 1.8, names: bool = False) -> None:
    """Top view, equal axes: truth as broad grey lines, estimates over it, links; a disc, with a name, where
    an agent starts. ``width``: of a line, points.
    """
    from matplotlib.collections import LineCollection

    for xy in view.truths:
        grey = {"color": TRUTH, "linewidth": 2.8 * width, "solid_capstyle": "round", "gid": tip("ground truth")}
        axes.plot(xy[:, 0], xy[:, 1], **grey)
    for path in view.paths:
        thick = 0.55 * width if path.faint else width
        axes.plot(path.xy[:, 0], path.xy[:, 1], linewidth=thick, gid=tip(path.name), **style_of(path.index))
    links: dict[str, Any] = {"colors": INK, "linewidths": 0.5 * width, "alpha": 0.45, "gid": tip("accepted match")}
    axes.add_collection(LineCollection(list(view.links), **links))
    for path in view.paths:
        if names and len(path.xy):
            colour = colour_of(path.index)
            axes.plot(*path.xy[0], "o", color=colour, markeredgecolor="white", gid=tip(f"{path.name} starts here"))
            box = {"facecolor": "white", "alpha": 0.7, "linewidth": 0, "pad": 1}
            place = {"xytext": (6, 4), "textcoords": "offset points", "bbox": box}
            axes.annotate(path.name, path.xy[0], color=colour, weight="bold", **place)
    axes.set_aspect("equal", adjustable="datalim")
    dress(axes)


def draw_lines(axes: Any, times_s: Array, series: Mapping[str, Array], moments_s: Sequence[float] = ()) -> None:
    """One line per name over time, from zero; thin vertical lines at ``moments_s``."""
    for moment in moments_s:
        axes.axvline(moment, color=FAINT, linewidth=0.8, linestyle=(0, (2, 3)), gid=tip("an optimisation ended"))
    for index, (name, line) in enumerate(series.items()):
        axes.plot(times_s, line, linewidth=1.4, gid=tip(name), **style_of(index))
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)


def draw_bytes(axes: Any, times_s: Array, cumulative: Mapping[str, Array]) -> None:
    """Bytes since the start, one band per operation, stacked."""
    from matplotlib.ticker import EngFormatter, MaxNLocator

    below = np.zeros(len(times_s))
    for name, values in cumulative.items():
        band = {"color": OPERATION_COLOUR[name], "linewidth": 0, "label": OPERATIONS[name]}
        axes.fill_between(times_s, below, below + values, gid=tip(OPERATIONS[name]), **band)
        below = below + values
    axes.set_ylim(0.0, max(axes.get_ylim()[1], 1.0))
    axes.margins(x=0.01)
    axes.yaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 2.5, 5, 10], integer=True))
    axes.yaxis.set_major_formatter(EngFormatter("B"))


def map_chart(view: TopView, unit: str = "metres") -> str:
    """SVG of a large map, as tall as what it shows; ``unit``: of its axes."""
    with house_figure((_WIDE, _WIDE * _shape([*view.truths, *(path.xy for path in view.paths)]))) as figure:
        axes = figure.add_subplot()
        draw_map(axes, view, names=True)
        dress(axes, "", unit, unit)
        return inline_svg(figure, "top view of all trajectories")


def copy_chart(name: str, view: TopView) -> str:
    """SVG of a small map: what agent ``name`` holds."""
    with house_figure(_SMALL) as figure:
        axes = figure.add_subplot()
        draw_map(axes, view)
        axes.tick_params(labelbottom=False, labelleft=False)
        return inline_svg(figure, f"top view of the maps that {name} holds")


def lines_chart(times_s: Array, series: Mapping[str, Array], y_label: str, moments_s: Sequence[float]) -> str:
    """SVG of :func:`draw_lines`, with the mean of all in black where there are several."""
    with house_figure(_HALF) as figure:
        axes = figure.add_subplot()
        draw_lines(axes, times_s, series, moments_s)
        if len(series) > 1:
            stacked = np.array(list(series.values()), dtype=float)
            known = np.isfinite(stacked).any(axis=0)
            axes.plot(times_s[known], np.nanmean(stacked[:, known], axis=0), color=INK, linewidth=2.4, gid=tip("mean"))
            axes.set_ylim(bottom=0.0)
        dress(axes, "", "time, s", y_label)
        return inline_svg(figure, f"{y_label} over time")


def bytes_chart(times_s: Array, cumulative: Mapping[str, Array]) -> str:
    """SVG of :func:`draw_bytes`."""
    with house_figure(_HALF) as figure:
        axes = figure.add_subplot()
        draw_bytes(axes, times_s, cumulative)
        dress(axes, "", "time, s", "bytes sent")
        return inline_svg(figure, "bytes by operation over time")


def _shape(lines: Sequence[Array]) -> float:
    """Height of a map over its width, for what is drawn on it."""
    known = np.concatenate([np.zeros((0, 2)), *lines])
    known = known[np.isfinite(known).all(axis=1)]
    width, height = np.ptp(known, axis=0) if len(known) else (1.0, 1.0)
    return float(np.clip(height / max(width, 1e-9), _FLATTEST, _TALLEST))


def bars(entries: Sequence[tuple[str, float, str, str]], highest: float) -> str:
    """HTML bars: ``(name, value, text, colour)`` each, as long as their share of ``highest``."""
    rows = []
    for name, value, text, colour in entries:
        share = 100 * value / highest if highest > 0 else 0.0
        bar = f'<div class="bar"><div style="width:{share:.1f}%;background:{colour}"></div></div>'
        rows.append(f"<span>{escape(name)}</span>{bar}<b>{escape(text)}</b>")
    return f'<div class="bars">{"".join(rows)}</div>'


def traffic_matrix(names: Sequence[str], wire_bytes: NDArray[np.int64]) -> str:
    """HTML table: bytes from each row's agent to each column's, darker where more."""
    highest = int(wire_bytes.max()) if wire_bytes.size else 0
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    rows = []
    for i, name in enumerate(names):
        cells = []
        for j in range(len(names)):
            share = wire_bytes[i, j] / highest if highest else 0.0
            ink = "#fff" if share > 0.55 else INK
            style = f"background:rgba(0,114,178,{0.9 * share:.3f});color:{ink}"
            text = "" if i == j else format_bytes(int(wire_bytes[i, j]))
            cells.append(f'<td style="{style}">{text}</td>' if i != j else '<td class="none">·</td>')
        total = format_bytes(int(wire_bytes[i].sum()))
        rows.append(f"<tr><th>{escape(name)}</th>{''.join(cells)}<td><b>{total}</b></td></tr>")
    received = "".join(f"<td><b>{format_bytes(int(n))}</b></td>" for n in wire_bytes.sum(axis=0))
    rows.append(f"<tr><th>received</th>{received}<td><b>{format_bytes(int(wire_bytes.sum()))}</b></td></tr>")
    return f'<table class="matrix"><tr><th>from \\ to</th>{head}<th>sent</th></tr>{"".join(rows)}</table>'


def format_bytes(count: float) -> str:
    """1234567 is 1.23 MB."""
    for limit, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if abs(count) >= limit:
            return f"{count / limit:.3g} {unit}" if count / limit < 1000 else f"{count / limit:.0f} {unit}"
    return f"{count:g} B"
