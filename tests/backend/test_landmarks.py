"""Landmarks of a g2o file come out again where the poses that see them have gone, whatever the method and the ids."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from graphs import loops

from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3_inverse, transform_points
from maslam.backend.pose_graph.g2o import read_g2o, write_g2o
from maslam.backend.pose_graph.g2o_ids import symbol
from maslam.backend.pose_graph.graph import NodeId, PoseGraph
from maslam.tools import cli

METHODS = ["central", "elected", "multifrontal", "two-level", "rbcd", "dgs"]
SEEN = np.array([1.0, 2.0, 5.0])
"""By the fourth pose of the second robot, in its frame."""


def label(letter: str, group: str, index: int) -> int:
    """A labelled symbol of gtsam's."""
    return (ord(letter) << 56) | (ord(group) << 48) | index


def team(folder: Path, naming: str) -> tuple[Path, int, PoseGraph]:
    """A file of two robots and a landmark that the second sees twice, the file's id of the landmark, and the graph."""
    graph, _ = loops(np.random.default_rng(9), robots=2, length=12, sigma_t=0.05)
    path = folder / "in.g2o"
    write_g2o(path, graph)
    text = path.read_text()
    names = {symbol(n): symbol(n) for n in graph.nodes}
    mark = (ord("l") << 56) | 7
    if naming == "labels":
        names = {symbol(n): label("g", "AB"[n.robot], n.index) for n in graph.nodes}
        mark = label("l", "A", 7)
    lines = []
    for line in text.splitlines():
        tag, *fields = line.split()
        ids = 2 if tag.startswith("EDGE") else 1
        lines.append(" ".join([tag, *(str(names[int(f)]) for f in fields[:ids]), *fields[ids:]]))
    who = [names[symbol(NodeId(1, k))] for k in (3, 4)]
    place = transform_points(graph.poses[NodeId(1, 3)], SEEN[None])[0]
    lines.append(f"VERTEX_TRACKXYZ {mark} " + " ".join(f"{v:.12g}" for v in place))
    lines.append(f"EDGE_SE3_TRACKXYZ {who[0]} {mark} 0 1 2 5 4 0 0 4 0 4")
    lines.append(f"EDGE_SE3_TRACKXYZ {who[1]} {mark} 0 1 2 4 4 0 0 4 0 4")
    path.write_text("\n".join(lines) + "\n")
    return path, mark, graph


@pytest.mark.parametrize("naming", ["symbols", "labels"])
@pytest.mark.parametrize("method", METHODS)
def test_landmarks_go_with_the_pose_that_sees_them(method, naming, tmp_path, capsys) -> None:
    path, mark, _ = team(tmp_path, naming)
    out = tmp_path / "out.g2o"
    assert cli.main(["pgo", str(path), str(out), "--method", method, "--json"]) == 0
    assert any("1 landmarks and 2 measurements" in w for w in json.loads(capsys.readouterr().out)["warnings"])
    before, after = read_g2o(path), read_g2o(out)
    robot = sorted(before.robots)[1]
    node = NodeId(robot, 3)
    assert not np.allclose(before.poses[node], after.poses[node], atol=1e-6)
    (landmark,) = after.landmarks
    assert landmark.name == mark
    seen = transform_points(se3_inverse(after.poses[node]), landmark.position(after.poses)[None])[0]
    np.testing.assert_allclose(seen, SEEN, atol=1e-6)
    # Its measurements are what they were, of the poses that they were of.
    assert [(s.node, s.rest) for s in landmark.sightings] == [
        (NodeId(robot, 3), "0 1 2 5 4 0 0 4 0 4"),
        (NodeId(robot, 4), "0 1 2 4 4 0 0 4 0 4"),
    ]
    # A folder has it in the file of who sees it.
    assert cli.main(["pgo", str(path), str(tmp_path / "folder"), "--method", method, "--quiet"]) == 0
    whose = [p.stem for p in sorted((tmp_path / "folder").glob("*.g2o")) if "TRACKXYZ" in p.read_text()]
    assert len(whose) == 1


def test_plain_numbers_stay_and_those_of_a_set_get_a_letter_of_their_own(tmp_path) -> None:
    flat = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1.5 0 0 1 0 0 1 0 1\n"
    flat += "VERTEX_XY 7 1 1\nEDGE_SE2_XY 1 7 0 1 1 0 1\n"
    alone = tmp_path / "flat.g2o"
    alone.write_text(flat)
    write_g2o(tmp_path / "again.g2o", read_g2o(alone), plain_ids=True)
    again = read_g2o(tmp_path / "again.g2o")
    assert [m.name for m in again.landmarks] == [7]
    np.testing.assert_allclose(again.landmarks[0].position(again.poses), [1.0, 1.0, 0.0])
    files = [tmp_path / "0.g2o", tmp_path / "1.g2o"]
    for path in files:
        path.write_text(flat)
    both = read_g2o(files)
    assert len(both.landmarks) == 2 and {s.node.robot for m in both.landmarks for s in m.sightings} == {0, 1}
    write_g2o(tmp_path / "both.g2o", both)
    read = read_g2o(tmp_path / "both.g2o")
    assert len({m.name for m in read.landmarks}) == 2
    assert all(m.name >> 56 == ord("l") for m in read.landmarks)
    assert {s.node.robot for m in read.landmarks for s in m.sightings} == {0, 1}


def test_landmarks_that_make_no_sense_are_refused_with_their_line(tmp_path) -> None:
    path = tmp_path / "bad.g2o"
    for line, why in (
        ("VERTEX_XY 7 1", "VERTEX_XY has 2 numbers"),
        ("VERTEX_XY 7 1 nan", "VERTEX_XY has 2 numbers"),
        ("EDGE_SE2_XY 0", "names no vertex"),
        ("EDGE_SE2_XY 0 x 1 1 1 0 1", "names no vertex"),
    ):
        path.write_text(f"VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n{line}\n")
        with pytest.raises(BackendError, match=rf"bad.g2o:4: .*{why}"):
            read_g2o(path)


def test_what_has_no_pose_or_no_landmark_is_said(tmp_path) -> None:
    path, notes = tmp_path / "odd.g2o", []
    path.write_text(
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"
        "VERTEX_XY 7 1 1\nEDGE_SE2_XY 5 7 1 1 1 0 1\nEDGE_SE2_XY 0 8 1 1 1 0 1\n"
    )
    graph = read_g2o(path, notes=notes)
    assert [m.node for m in graph.landmarks] == [None]
    assert any("2 measurements of landmarks left out" in note for note in notes)
