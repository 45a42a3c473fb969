"""Pictures of ``maslam netvlad eval``: for each set precision over recall with hits and misses to look at, and for all
sets recall over bytes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_atomically
from maslam.descriptors.calibration import judge, precision_recall

from ..common.figures import FAINT, INK, colour_of, dress, saved_figure
from ..place_benchmarks.public_sets import PlaceBenchmark
from .scores import Evaluation, as_records

_WIRE_BYTES = 256
_ROWS, _TILE_PX = 4, (200, 150)
_RIGHT, _WRONG = "#009E73", "#D55E00"


def draw_evaluation(
    benchmarks: Sequence[PlaceBenchmark], results: Sequence[Sequence[Evaluation]], out: Path
) -> list[Path]:
    """Write ``<set>.png`` for each set (``results`` in the same order), ``bytes.png`` and ``scores.json`` into folder
    ``out``; their paths."""
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    for benchmark, evaluations in zip(benchmarks, results, strict=True):
        paths.append(out / f"{benchmark.name}.png")
        draw_set(benchmark, evaluations, paths[-1])
    paths += [out / "bytes.png", out / "scores.json"]
    scores = [[evaluation.score for evaluation in of_set] for of_set in results]
    draw_bytes(results, paths[-2])
    write_atomically(paths[-1], json.dumps(as_records([s for of_set in scores for s in of_set]), indent=1) + "\n")
    return paths


def draw_set(benchmark: PlaceBenchmark, evaluations: Sequence[Evaluation], path: Path) -> None:
    """Curves of all methods; hits and misses of the first one, as it goes over the wire."""
    ours = _on_wire([e for e in evaluations if e.score.method == evaluations[0].score.method])
    hits, misses = examples(benchmark, ours)
    rows = max(len(hits), len(misses))
    with saved_figure(path, (12.0, 3.9 + 1.62 * rows)) as figure:
        top, bottom = figure.subfigures(2, 1, height_ratios=[3.9, max(1.62 * rows, 0.01)])
        _curves(top, benchmark, evaluations)
        left, right = bottom.subfigures(1, 2, width_ratios=[2, 3], wspace=0.02)
        name = f"{ours.score.method} {ours.score.code}"
        if hits:
            left.suptitle(f"{name}: answered right", fontsize=9.5, color=_RIGHT, x=0.01, ha="left")
            _tiles(left.subplots(rows, 2, squeeze=False), benchmark, ours.distances, hits)
        if misses:
            right.suptitle("answered wrong, the surest first", fontsize=9.5, color=_WRONG, x=0.01, ha="left")
            _tiles(right.subplots(rows, 3, squeeze=False), benchmark, ours.distances, misses)


def draw_bytes(results: Sequence[Sequence[Evaluation]], path: Path) -> None:
    """Recall@1 over the bytes of one description, a panel for each set; a dot for each code of a method, a line along
    the best in so many bytes."""
    columns = min(3, len(results))
    rows = -(-len(results) // columns)
    with saved_figure(path, (3.9 * columns, 3.1 * rows + 0.4)) as figure:
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes, evaluations in zip(grid.flat, results, strict=False):
            for number, method in enumerate(_methods(evaluations)):
                points = sorted((e.score.bytes, e.score.recall_at_1) for e in evaluations if e.score.method == method)
                xs, ys = (np.array(column) for column in zip(*points, strict=True))
                axes.plot(xs, ys, "o", color=colour_of(number), markersize=4.5, label=method)
                axes.plot(xs, np.maximum.accumulate(ys), color=colour_of(number), linewidth=1.4)
            axes.set_xscale("log", base=2)
            ticks = [2**k for k in range(4, 16, 2)]
            axes.set_xticks(ticks, [f"{t}" if t < 1024 else f"{t // 1024}k" for t in ticks])
            axes.set_xlim(12, 22_000)
            axes.set_ylim(0.0, 1.02)
            dress(axes, evaluations[0].score.dataset, "bytes of a description", "recall@1")
        for axes in list(grid.flat)[len(results) :]:
            axes.set_visible(False)
        figure.legend(*grid[0, 0].get_legend_handles_labels(), ncols=6, loc="outside lower center")


def examples(benchmark: PlaceBenchmark, evaluation: Evaluation) -> tuple[list[int], list[int]]:
    """Queries to look at: hits from the surest to the least sure, and the surest misses, each of another place."""
    answers = evaluation.distances.argmin(axis=1)
    nearest = evaluation.distances[np.arange(len(answers)), answers]
    right = benchmark.truth[np.arange(len(answers)), answers]
    askable = benchmark.truth.any(axis=1) & np.isfinite(nearest)
    by_distance = np.argsort(nearest, kind="stable")
    hits = [int(q) for q in by_distance if askable[q] and right[q]]
    spread = np.unique(np.linspace(0, len(hits) - 1, min(_ROWS, len(hits))).round().astype(int)).tolist()
    misses: list[int] = []
    shown: set[int] = set()
    for query in (int(q) for q in by_distance if askable[q] and not right[q]):
        if int(answers[query]) not in shown and len(misses) < _ROWS:
            misses.append(query)
            shown.add(int(answers[query]))
    return [hits[k] for k in spread], misses


def _curves(figure: Any, benchmark: PlaceBenchmark, evaluations: Sequence[Evaluation]) -> None:
    """Precision over recall, each method whole (solid) and in about 256 bytes (dashed)."""
    left, right = figure.subfigures(1, 2, width_ratios=[1, 1.1])
    axes = left.subplots(1, 1)
    for number, method in enumerate(_methods(evaluations)):
        codes = [e for e in evaluations if e.score.method == method]
        drawn = [codes[0]] if _on_wire(codes) is codes[0] else [codes[0], _on_wire(codes)]
        for dashes, one in zip(((None, None), (4, 2)), drawn, strict=False):
            found = judge(one.distances, benchmark.truth)
            curve, s = precision_recall(found), one.score
            figures = f"R@1 {s.recall_at_1:.3f}  R@5 {s.recall_at_5:.3f}  AP {s.ap:.3f}"
            label = f"{method}, {s.code}, {s.bytes} bytes:  {figures}"
            axes.plot(curve.recall, curve.precision, color=colour_of(number), dashes=dashes, linewidth=1.8, label=label)
    queries = evaluations[0].score.queries
    title = f"{benchmark.name}: {queries} queries, {len(benchmark.references)} references"
    dress(axes, title, "recall of the nearest neighbour, if it is near enough", "precision")
    axes.set_xlim(-0.01, 1.01)
    axes.set_ylim(0.0, 1.03)
    right.legend(*axes.get_legend_handles_labels(), fontsize=8.5, loc="center left")


def _tiles(grid: Any, benchmark: PlaceBenchmark, distances: NDArray[np.float32], queries: Sequence[int]) -> None:
    """A row for each query: the query, the answer and, where there is room, the right answer that came nearest."""
    for axes in grid.flat:
        axes.set_axis_off()
    for line, query in enumerate(queries):
        answer = int(distances[query].argmin())
        own = int(np.where(benchmark.truth[query], distances[query], np.inf).argmin())
        right = bool(benchmark.truth[query, answer])
        shown = [(benchmark.queries[query], _where(benchmark, query), FAINT)]
        for reference, colour in ((answer, _RIGHT if right else _WRONG), (own, _RIGHT)):
            text = f"distance {distances[query, reference]:.3f}, {_apart(benchmark, query, reference)}"
            shown.append((benchmark.references[reference], text, colour))
        for axes, (image, text, colour) in zip(grid[line], shown, strict=False):
            _tile(axes, image, text, colour)
        if line == 0:
            for axes, word in zip(grid[0], ("query", "answer", "right answer"), strict=False):
                axes.annotate(word, (0.0, 1.03), xycoords="axes fraction", fontsize=8, color=FAINT, va="bottom")


def _tile(axes: Any, image: NDArray[np.uint8], text: str, colour: str) -> None:
    axes.set_axis_on()
    shown = image[:, :, ::-1] if image.ndim == 3 else image
    height, width = shown.shape[:2]
    if width < _TILE_PX[0]:
        scale = _TILE_PX[0] / width
        shown = cv2.resize(shown, (_TILE_PX[0], round(height * scale)), interpolation=cv2.INTER_LINEAR)
    axes.imshow(shown, cmap="gray", vmin=0, vmax=255)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_xlabel(text, fontsize=7.5, color=INK, labelpad=2)
    for spine in axes.spines.values():
        spine.set_color(colour)
        spine.set_linewidth(2.0)


def _where(benchmark: PlaceBenchmark, query: int) -> str:
    if benchmark.poses is None:
        return f"image {query}"
    x, y, z = benchmark.poses[0][query, :3, 3]
    return f"image {query}, at ({x:.1f}, {y:.1f}, {z:.1f}) m"


def _apart(benchmark: PlaceBenchmark, query: int, reference: int) -> str:
    if benchmark.poses is None:
        return f"image {reference}"
    a, b = benchmark.poses[0][query], benchmark.poses[1][reference]
    apart_m = float(np.linalg.norm(a[:3, 3] - b[:3, 3]))
    turned_deg = float(np.degrees(np.arccos(np.clip(a[:3, 2] @ b[:3, 2], -1.0, 1.0))))
    return f"{apart_m:.1f} m and {turned_deg:.0f}° off"


def _methods(evaluations: Sequence[Evaluation]) -> list[str]:
    return list(dict.fromkeys(e.score.method for e in evaluations))


def _on_wire(codes: Sequence[Evaluation]) -> Evaluation:
    """Of one method's codes the finest that takes 256 bytes or less; its first where none is so short."""
    short = [e for e in codes if e.score.bytes <= _WIRE_BYTES]
    return max(short, key=lambda e: e.score.bytes) if short else codes[0]
