"""Charts, as a page and as files have them: breaks in lines, equal axes, number formats, bands, styles."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from maslam.tools.common.figures import DASHES, PALETTE, dress, house_figure, inline_svg, saved_figure, style_of, tip
from maslam.tools.common.plane import plane_of
from maslam.tools.report.charts import (
    Path2D,
    TopView,
    bars,
    bytes_chart,
    copy_chart,
    draw_bytes,
    draw_map,
    format_bytes,
    lines_chart,
    map_chart,
    traffic_matrix,
)
from maslam.tools.report.html import legend
from maslam.tools.report.match_images import choose

NOTHING = np.zeros((0, 2))


def test_numbers_are_short() -> None:
    assert [format_bytes(v) for v in (0, 999, 1234, 71_617_181, 2.5e9)] == [
        "0 B",
        "999 B",
        "1.23 kB",
        "71.6 MB",
        "2.5 GB",
    ]


def paths_of(svg: str, title: str) -> list[str]:
    """Path data of what is called ``title``."""
    groups = ElementTree.fromstring(svg).iter("g")
    return [path.attrib["d"] for g in groups if g.findtext("title") == title for path in g.iter("path")]


def test_a_line_breaks_where_nothing_is_known() -> None:
    with house_figure((2.0, 2.0)) as figure:
        axes = figure.add_subplot()
        axes.plot([0, 1, 2, 3, 4], [0.0, 1.0, np.nan, 1.0, 1.0], gid=tip("known"))
        (path,) = paths_of(inline_svg(figure, "x"), "known")
    pieces = [[float(point.split()[0]) for point in piece.split("L")] for piece in path.split("M")[1:]]
    assert len(pieces) == 2 and pieces[1][0] - pieces[0][-1] == pytest.approx(2 * np.ptp(pieces[0]), abs=0.4)


def test_equal_axes_make_a_metre_a_metre_both_ways() -> None:
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    for shape in (NOTHING, np.array([[0.0, 0.0], [100.0, 0.0]])):
        view = TopView([Path2D("square", square, 0), Path2D("other", shape, 1)], [])
        numbers = np.array(re.findall(r"-?[\d.]+", paths_of(map_chart(view), "square")[0]), dtype=float).reshape(-1, 2)
        width, height = np.ptp(numbers, axis=0)
        assert width > 10 and width == pytest.approx(height, abs=0.21)


def test_a_page_gets_a_chart_that_needs_nothing_but_the_page() -> None:
    xy = np.cumsum(np.random.default_rng(0).normal(size=(400, 2)), axis=0)
    view = TopView([Path2D("agent_00", xy, 0), Path2D("a<b", xy[:3], 9)], [xy], np.array([[[0.0, 0.0], [1.0, 1.0]]]))
    chart = map_chart(view)
    assert not re.search(r"https?:|url\(|href|font-family|<style|<script|<use| id=", chart)
    assert chart == map_chart(view) and len(chart) < 16_000
    assert len(paths_of(chart, "ground truth")) == len(paths_of(chart, "agent_00")) == len(paths_of(chart, "a<b")) == 1
    assert len(paths_of(chart, "agent_00 starts here")) == 1 and "C" in paths_of(chart, "agent_00 starts here")[0]


def test_more_series_than_colours_differ_by_their_dashes() -> None:
    styles = [tuple(style_of(k).items()) for k in range(len(PALETTE) * len(DASHES))]
    assert len(set(styles)) == len(styles)
    key = legend([("one", PALETTE[0], ()), ("two", PALETTE[0], (6, 3))])
    assert 'stroke-dasharray="none"' in key and 'stroke-dasharray="6 3"' in key


def test_bands_of_bytes_stand_on_each_other() -> None:
    with house_figure((3.0, 2.0)) as figure:
        axes = figure.add_subplot()
        draw_bytes(axes, np.arange(3.0), {"dvpr": np.array([0.0, 1.0, 2.0]), "dopt": np.array([0.0, 0.0, 5.0])})
        extents = [band.get_paths()[0].get_extents() for band in axes.collections]
    assert [(box.ymin, box.ymax) for box in extents] == [(0.0, 2.0), (0.0, 7.0)]


@pytest.mark.parametrize(("sent", "shown"), [(0.0, ["0 B", "1 B"]), (3.0, ["0 B", "1 B", "2 B", "3 B"])])
def test_an_axis_of_bytes_has_no_fractions_of_one(sent: float, shown: list[str]) -> None:
    svg = ElementTree.fromstring(bytes_chart(np.arange(3.0), {"dvpr": np.array([0.0, 0.0, sent])}))
    marks = [text for one in svg.iter("text") if re.search(r"\dB$", text := re.sub(r"\s", "", "".join(one.itertext())))]
    assert marks == [text.replace(" ", "") for text in shown]


def test_a_copy_of_anothers_map_is_drawn_thinner() -> None:
    with house_figure((3.0, 2.0)) as figure:
        axes = figure.add_subplot()
        line = np.array([[0.0, 0.0], [1.0, 2.0]])
        draw_map(axes, TopView([Path2D("own", line, 0), Path2D("copy", line, 1, faint=True)], []))
        own, copy = (line.get_linewidth() for line in axes.lines)
    assert copy < own


@pytest.mark.parametrize("ending", [".png", ".svg", ".pdf"])
def test_the_same_drawing_gives_the_same_file_and_a_broken_one_none(tmp_path: Path, ending: str) -> None:
    def draw(path: Path, broken: bool = False) -> None:
        with saved_figure(path, (2.0, 2.0)) as figure:
            dress(figure.add_subplot(), "title", "x", "y")
            if broken:
                raise KeyboardInterrupt

    for name in ("a", "b"):
        draw(tmp_path / (name + ending))
    assert (tmp_path / f"a{ending}").read_bytes() == (tmp_path / f"b{ending}").read_bytes()
    with pytest.raises(KeyboardInterrupt):
        draw(tmp_path / f"c{ending}", broken=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"a{ending}", f"b{ending}"]


def test_the_top_view_looks_along_the_flattest_axis() -> None:
    spread = np.array([[0.0, 0.0, 0.0], [5.0, 1.0, 9.0]])
    assert plane_of(spread) == (0, 2)
    assert plane_of(spread[:, [1, 0, 2]]) == (1, 2)
    assert plane_of(np.zeros((0, 3))) == (0, 2)


def test_every_chart_is_well_formed_also_without_data() -> None:
    paths = [Path2D("a<b", np.array([[0.0, 0.0], [1.0, 2.0]]), 0), Path2D("b&c", NOTHING, 1)]
    charts = [
        map_chart(TopView(paths, [NOTHING])),
        map_chart(TopView([], [])),
        copy_chart("a<b", TopView(paths, [NOTHING])),
        lines_chart(np.zeros(0), {}, "m", []),
        lines_chart(np.arange(3.0), {"a": np.full(3, np.nan), "b": np.array([1.0, np.nan, 2.0])}, "m", [1.0]),
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
