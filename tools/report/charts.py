"""The charts of a report, each from plain arrays to SVG text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from ..common.plane import Array
from ..common.svg import FAINT, INK, Plot, colour_of, dash_of, format_tick

OPERATIONS = {
    "dvpr": "place queries",
    "relpose": "verification",
    "dopt": "optimisation",
    "mapmerge": "map sale",
    "negotiation": "negotiation",
}
OPERATION_COLOUR = dict(zip(OPERATIONS, ("#56B4E9", "#0072B2", "#D55E00", "#009E73", "#8d99a6"), strict=True))
TRUTH = "#b8c2cc"


@dataclass(frozen=True)
class Path2D:
    """One line on a map, metres: ``xy`` ``(N, 2)``; ``index`` chooses the colour; ``faint`` draws it thin (a copy of
    another's map).
    """

    name: str
    xy: Array
    index: int
    faint: bool = False


def map_chart(
    paths: Sequence[Path2D], truths: Sequence[Array], links: Array, size: tuple[int, int], names: bool = True
) -> str:
    """Top view in metres, equal axes: truth as broad grey lines, estimates over it, ``links`` ``(M, 2, 2)`` between
    matched places.
    """
    shown = [xy for xy in (*truths, *(p.xy for p in paths)) if len(xy)]
    everything = np.concatenate(shown) if shown else np.zeros((1, 2))
    everything = everything[np.isfinite(everything).all(axis=1)]
    low, high = everything.min(axis=0), everything.max(axis=0)
    pad = 0.05 * float((high - low).max() or 1.0)
    plot = Plot(
        *size,
        (low[0] - pad, high[0] + pad),
        (low[1] - pad, high[1] + pad),
        "metres",
        "metres" if names else "",
        equal=True,
    )
    for xy in truths:
        plot.line(xy[:, 0], xy[:, 1], TRUTH, "ground truth", width=6 if names else 4)
    for path in paths:
        width = 1.2 if path.faint else 2.2
        plot.line(path.xy[:, 0], path.xy[:, 1], colour_of(path.index), path.name, width, dash_of(path.index))
    if len(links):
        plot.segments(links[:, 0], links[:, 1], INK, width=1.1, opacity=0.45)
    for path in paths:
        if names and len(path.xy):
            plot.mark(
                path.xy[0, 0], path.xy[0, 1], colour_of(path.index), title=f"{path.name} starts here", text=path.name
            )
    return plot.svg("top view of all trajectories")


def lines_chart(
    times_s: Array,
    series: Mapping[str, Array],
    y_label: str,
    moments_s: Sequence[float] = (),
    mean: bool = False,
    top: float | None = None,
) -> str:
    """One line a name over time; thin vertical lines at ``moments_s``; the mean of all in black where asked for."""
    values = np.concatenate([np.asarray(v, float) for v in series.values()]) if series else np.zeros(1)
    finite = values[np.isfinite(values)]
    high = top if top is not None else float(finite.max()) * 1.08 if len(finite) else 1.0
    plot = Plot(
        540, 290, (0.0, float(times_s[-1]) if len(times_s) else 1.0), (0.0, max(high, 1e-9)), "time, s", y_label
    )
    plot.vertical(moments_s, FAINT, "an optimisation ended")
    for index, (name, line) in enumerate(series.items()):
        plot.line(times_s, line, colour_of(index), name, dash=dash_of(index), opacity=0.9)
    if mean and len(series) > 1:
        stacked = np.array(list(series.values()), dtype=float)
        known = np.isfinite(stacked).any(axis=0)
        plot.line(times_s[known], np.nanmean(stacked[:, known], axis=0), INK, "mean", width=2.6)
    return plot.svg(y_label)


def bytes_chart(times_s: Array, cumulative: Mapping[str, Array]) -> str:
    """Bytes since the start, one band an operation, stacked."""
    total = np.sum(list(cumulative.values()), axis=0) if cumulative else np.zeros(1)
    plot = Plot(
        540,
        290,
        (0.0, float(times_s[-1]) if len(times_s) else 1.0),
        (0.0, float(total.max()) * 1.05 or 1.0),
        "time, s",
        "wire bytes",
    )
    below = np.zeros(len(times_s))
    for name, values in cumulative.items():
        plot.area(times_s, below, below + values, OPERATION_COLOUR[name], OPERATIONS[name])
        below = below + values
    return plot.svg("bytes by operation over time")


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
    return f"{format_tick(count)} B"
