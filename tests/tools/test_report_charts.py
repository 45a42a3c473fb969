"""The report's drawing: ticks, number formats, breaks in lines and equal axes, against values worked out by hand."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from maslam.tools.common.plane import plane_of
from maslam.tools.common.svg import Plot, format_tick, nice_ticks
from maslam.tools.report.charts import Path2D, bars, bytes_chart, format_bytes, lines_chart, map_chart, traffic_matrix
from maslam.tools.report.match_images import choose


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0, 10, [0, 2, 4, 6, 8, 10]),
        (-0.13, 0.42, [-0.1, 0.0, 0.1, 0.2, 0.3, 0.4]),
        (3, 3, [3]),
        (0, 1e6, [0, 2e5, 4e5, 6e5, 8e5, 1e6]),
    ],
)
def test_ticks_are_round(low: float, high: float, expected: list[float]) -> None:
    np.testing.assert_allclose(nice_ticks(low, high, 6), expected, atol=1e-12)


def test_numbers_are_short() -> None:
    assert [format_tick(v) for v in (0.0, -1e-15, 0.25, 9000, 15000, 2.5e6, 3e9)] == [
        "0",
        "0",
        "0.25",
        "9000",
        "15k",
        "2.5M",
        "3G",
    ]
    assert [format_bytes(v) for v in (0, 999, 1234, 71_617_181, 2.5e9)] == [
        "0 B",
        "999 B",
        "1.23 kB",
        "71.6 MB",
        "2.5 GB",
    ]


def test_a_line_breaks_where_nothing_is_known() -> None:
    plot = Plot(100, 100, (0, 3), (0, 1), frame=False, margins=(0, 0, 0, 0))
    plot.line([0, 1, 2, 3], [0.0, np.nan, 1.0, 1.0], "#000")
    assert re.search(r' d="([^"]+)"', plot.svg("x")).group(1) == "M0.0 100.0M66.7 0.0L100.0 0.0"  # type: ignore[union-attr]


def test_equal_axes_make_a_metre_a_metre_both_ways() -> None:
    plot = Plot(300, 100, (0, 10), (0, 10), equal=True, margins=(0, 0, 0, 0))
    assert plot.x == (-10, 20) and plot.y == (0, 10)


def test_the_top_view_looks_along_the_flattest_axis() -> None:
    spread = np.array([[0.0, 0.0, 0.0], [5.0, 1.0, 9.0]])
    assert plane_of(spread) == (0, 2)
    assert plane_of(spread[:, [1, 0, 2]]) == (1, 2)
    assert plane_of(np.zeros((0, 3))) == (0, 2)


def test_every_chart_is_well_formed_also_without_data() -> None:
    nothing = np.zeros((0, 2))
    paths = [Path2D("a<b", np.array([[0.0, 0.0], [1.0, 2.0]]), 0), Path2D("b&c", nothing, 1)]
    charts = [
        map_chart(paths, [nothing], np.zeros((0, 2, 2)), (300, 200)),
        map_chart([], [], np.zeros((0, 2, 2)), (300, 200)),
        lines_chart(np.zeros(0), {}, "m"),
        lines_chart(
            np.arange(3.0), {"a": np.full(3, np.nan), "b": np.array([1.0, np.nan, 2.0])}, "m", [1.0], mean=True
        ),
        bytes_chart(np.arange(2.0), {"dvpr": np.zeros(2)}),
        f"<div>{bars([('a<b', 0.0, '0', '#000')], 0.0)}</div>",
        traffic_matrix(["a<b", "c"], np.array([[0, 5], [0, 0]])),
    ]
    for chart in charts:
        ElementTree.fromstring(chart)
        assert "nan" not in chart.lower()


def test_images_come_from_as_many_pairs_as_possible() -> None:
    def row(query: int, match: int, inliers: int) -> dict[str, str]:
        return {"query_agent": str(query), "match_agent": str(match), "inliers": str(inliers), "time_s": "0"}

    rows = [row(0, 0, 99), row(0, 1, 20), row(1, 0, 40), row(2, 1, 30), *(row(0, 1, k) for k in range(6))]
    assert [(r["query_agent"], r["match_agent"], r["inliers"]) for r in choose(rows)][:4] == [
        ("1", "0", "40"),
        ("2", "1", "30"),
        ("0", "0", "99"),
        ("0", "1", "20"),
    ]
    assert len(choose(rows)) == 6 and choose([]) == []
