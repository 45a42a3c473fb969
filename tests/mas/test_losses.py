"""Twelve constructed losses, and what the console, ``summary.json`` and the report say of each: the table of
docs/concepts/losses.md."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from factory import circuit, make_sequence, make_world, manifest_of
from test_sequence import write

from maslam.backend.geometry import Array
from maslam.frontend.files.trajectory import Trajectory
from maslam.mas.manifest import MANIFEST, LeftOutEntry, LostEntry, Manifest, write_manifest
from maslam.mas.sequence import AgentSequence
from maslam.tools import cli

PAGE = Path(__file__).resolve().parents[2] / "docs" / "concepts" / "losses.md"
WORLD = make_world(3)
Parts = tuple[list[AgentSequence], tuple[LeftOutEntry, ...]]


@dataclass(frozen=True)
class Loss:
    """A made-up run: ``coverage``: read, tracked, placed, tracks, tracks placed of each agent; ``exploration``: percent
    of each, or its bounds where map copies add to the agent's own frames; ``lost``: intervals of all agents; ``said``:
    on the console and in the report; ``printed``: on the console alone; ``shown``: in the report alone; ``tile``: the
    report's frames placed, and their mood."""

    make: Callable[[], Parts]
    coverage: list[tuple[int, int, int, int, int]]
    exploration: list[float] | list[tuple[float, float]]
    said: tuple[str, ...]
    lost: int = 0
    printed: tuple[str, ...] = ()
    shown: tuple[str, ...] = ()
    tile: tuple[str, str] = ("", "")


def drive(
    number: int, *ways: Array, cuts: tuple[int, ...] = (), scale: float = 1.0, truth: bool = True
) -> AgentSequence:
    return make_sequence(WORLD, np.concatenate(ways), 3, number, scale=scale, cuts=cuts, with_truth=truth)


def without(sequence: AgentSequence, track: int, reason: str) -> AgentSequence:
    """The frames of a track were read and lost."""
    frames = np.flatnonzero(sequence.track_of(sequence.trajectory.stamps_ns) == track)
    of_frame, of_keyframe = np.ones(len(sequence.trajectory), dtype=bool), sequence.keyframe_tracks != track
    of_frame[frames] = False
    places, trajectory = sequence.places, sequence.trajectory
    return replace(
        sequence,
        frames=len(trajectory),
        tracks=tuple(t for k, t in enumerate(sequence.tracks) if k != track),
        trajectory=Trajectory(trajectory.stamps_ns[of_frame], trajectory.poses[of_frame]),
        places=replace(
            places,
            stamps_ns=places.stamps_ns[of_keyframe],
            vectors=places.vectors[of_keyframe],
            textured=places.textured[of_keyframe],
        ),
        lost=(LostEntry(first_frame=int(frames[0]), last_frame=int(frames[-1]), reason=reason),),
    )


def shared_images() -> Parts:
    """Two agents that were given the same forty-two frames of one recording, and nothing else."""
    way = circuit(0.0, 21.0)
    return [replace(make_sequence(WORLD, way, 3, a), source="drive", start_ns=0) for a in range(2)], ()


def doubtful() -> Parts:
    entry = LostEntry(first_frame=30, last_frame=41, reason="12 points agree on a pose, 20 are needed")
    return [replace(drive(0, circuit(0.0, 30.0)), doubtful=(entry,))], ()


def two_groups() -> Parts:
    starts = (0.0, 5.0, 80.0, 85.0)
    return [drive(a, circuit(s, 21.0)) for a, s in enumerate(starts)], ()


LOSSES = {
    "black-out": Loss(
        lambda: ([without(drive(0, circuit(0.0, 30.0), circuit(6.0, 45.0), cuts=(60, 90)), 1, "too dark")], ()),
        [(150, 120, 120, 2, 2)],
        [80.0],
        ("30 frames lost (60 to 89): too dark", "2 of 2"),
        lost=1,
        tile=("120 of 150", "bad"),
    ),
    "two tracks": Loss(
        lambda: ([drive(0, circuit(0.0, 30.0), circuit(90.0, 24.0), cuts=(60,))], ()),
        [(108, 108, 60, 2, 1)],
        [100 * 60 / 108],
        ("1 track that nothing joins, 48 tracked frames without a place", "1 of 2"),
        tile=("60 of 108", "bad"),
    ),
    "no match": Loss(
        lambda: ([drive(0, circuit(0.0, 21.0)), drive(1, circuit(90.0, 21.0))], ()),
        [(42, 42, 42, 1, 1)] * 2,
        [50.0, 50.0],
        ("1 of 2",),
        shown=("Agents in 2 frames that no match joins",),
        tile=("84 of 84", ""),
    ),
    "late start": Loss(
        lambda: (
            [drive(0, circuit(0.0, 24.0)), without(drive(1, circuit(5.0, 30.0), cuts=(15,)), 0, "no first view yet")],
            (),
        ),
        [(48, 48, 48, 1, 1), (60, 45, 45, 1, 1)],
        [(100 * 48 / 108, 100 * 93 / 108), (100 * 45 / 108, 100 * 93 / 108)],
        ("agent_01: 15 frames lost (0 to 14): no first view yet",),
        lost=1,
        tile=("93 of 108", "bad"),
    ),
    "a track of 3 key-frames": Loss(
        lambda: ([drive(0, circuit(0.0, 36.0), circuit(90.0, 4.5), cuts=(72,))], ()),
        [(81, 81, 72, 2, 1)],
        [100 * 72 / 81],
        ("1 track that nothing joins, 9 tracked frames without a place",),
        tile=("72 of 81", "bad"),
    ),
    "an agent that never starts": Loss(
        lambda: (
            [drive(0, circuit(0.0, 21.0))],
            (LeftOutEntry(sequence="dark", frames=42, reason="no frame of 42 could be tracked: too dark (42 x)"),),
        ),
        [(42, 42, 42, 1, 1)],
        [50.0],
        (
            "sequence dark: no agent, 42 frames: no frame of 42 could be tracked: too dark (42 x)",
            "measured on 42 of 84 frames",
            "1 of 2",
            "without a place: sequence dark",
        ),
        tile=("42 of 84", "bad"),
    ),
    "a sequence that ends early": Loss(
        lambda: ([drive(0, circuit(0.0, 30.0)), drive(1, circuit(5.0, 9.0))], ()),
        [(60, 60, 60, 1, 1), (18, 18, 18, 1, 1)],
        [(100 * 60 / 78, 100.0), (100 * 18 / 78, 100.0)],
        ("2 of 2",),
        tile=("78 of 78", ""),
    ),
    "two groups": Loss(
        two_groups,
        [(42, 42, 42, 1, 1)] * 4,
        [(25.0, 50.0)] * 4,
        ("2 of 4",),
        shown=("Agents in 2 frames that no match joins",),
        tile=("168 of 168", ""),
    ),
    "all frames lost": Loss(
        lambda: ([without(drive(0, circuit(0.0, 21.0)), 0, "too few points")], ()),
        [(42, 0, 0, 0, 0)],
        [0.0],
        ("42 frames lost (0 to 41): too few points", "0 of 0"),
        printed=("no frame has both a place and a true one: errors cannot be known",),
        shown=("too few poses with a true one",),
        lost=1,
        tile=("0 of 42", "bad"),
    ),
    "a doubtful stretch": Loss(
        doubtful,
        [(60, 60, 60, 1, 1)],
        [100.0],
        ("12 frames doubtful (30 to 41): 12 points agree on a pose, 20 are needed",),
        tile=("60 of 60", ""),
    ),
    "one camera, two units": Loss(
        lambda: ([drive(a, circuit(90.0 * a, 21.0), scale=s, truth=False) for a, s in enumerate((0.5, 0.2))], ()),
        [(42, 42, 42, 1, 1)] * 2,
        [50.0, 50.0],
        (),
        printed=("lengths in their files are in units of their own, not metres",),
        shown=("arbitrary unit (one camera, no scale)", "a frame's unit of length is its own and no metre"),
        tile=("84 of 84", ""),
    ),
    "the same images only": Loss(
        shared_images,
        [(42, 42, 42, 1, 1)] * 2,
        [100.0, 100.0],
        ("1 of 2", "same image"),
        shown=("of one and the same image, which is no evidence", "Agents in 2 frames that no match joins"),
        tile=("84 of 84", ""),
    ),
}


def manifest(parts: Parts) -> Manifest:
    sequences, left_out = parts
    return manifest_of(sequences).model_copy(update={"left_out": left_out})


@pytest.mark.parametrize("name", LOSSES)
def test_a_loss_is_said(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loss = LOSSES[name]
    parts = loss.make()
    (tmp_path / "seqs").mkdir()
    write(tmp_path / "seqs", parts[0])
    write_manifest(tmp_path / "seqs", manifest(parts))
    run = tmp_path / "run"
    assert cli.main(["run", str(tmp_path / "seqs"), str(run), "--preset", "default", "--quiet"]) == 0
    console = capsys.readouterr().out
    summary = json.loads((run / "summary.json").read_text())
    keys = ("read", "tracked", "placed", "tracks", "tracks_placed")
    assert [tuple(c[key] for key in keys) for c in summary["coverage"]] == loss.coverage
    for percent, expected in zip(summary["exploration_percent"], loss.exploration, strict=True):
        if isinstance(expected, tuple):
            assert expected[0] < percent <= expected[1] + 1e-9
        else:
            assert percent == pytest.approx(expected)
    assert sum(len(c["lost"]) for c in summary["coverage"]) == loss.lost
    assert not summary["matches"]["false_accepted"]
    assert cli.main(["eval", str(run)]) == 0
    assert capsys.readouterr().out == console
    assert cli.main(["report", str(run)]) == 0
    page = unescape((run / "report" / "index.html").read_text())
    for words in loss.said:
        assert words in console and words in page, words
    assert all(words in page for words in loss.shown) and all(words in console for words in loss.printed)
    tile = re.search(r'class="tile ?(\w*)"><span>frames placed</span><b>[\d.]+ %</b><em>(.*?) read</em>', page)
    assert tile is not None and (tile[2], tile[1]) == loss.tile
    if loss.coverage[0][2] < loss.coverage[0][0] and len(loss.coverage) == 1:
        assert "100.0 %" not in console and "100.0 %" not in page


def test_what_is_said_of_same_images_is_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parts = shared_images()
    write(tmp_path, parts[0])
    assert cli.main(["run", str(tmp_path), str(tmp_path / "run"), "--preset", "default", "--quiet"]) == 0
    matches = json.loads((tmp_path / "run" / "summary.json").read_text())["matches"]
    assert matches["same_image"] == matches["candidates"] >= 10 and matches["accepted"] == 0
    said = f"{matches['same_image']} pairs of one image seen by two agents, no evidence"
    assert said in capsys.readouterr().out


def test_agents_without_a_place_are_counted_among_those_that_could_share_a_frame(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two that meet, one whose frames were all lost, one of which no agent was made: two of four."""
    met = [drive(a, circuit(5.0 * a, 21.0)) for a in range(2)]
    lost = without(drive(2, circuit(60.0, 21.0)), 0, "too few points")
    parts = [*met, lost], (LeftOutEntry(sequence="cellar", frames=42, reason="too dark"),)
    write(tmp_path, parts[0])
    write_manifest(tmp_path, manifest(parts))
    run = tmp_path / "run"
    assert cli.main(["run", str(tmp_path), str(run), "--preset", "default", "--quiet"]) == 0
    assert "2 of 4 agents share one frame; without a place: agent_02, sequence cellar" in capsys.readouterr().out
    expected = {"agents": 2, "of": 4, "without": ["agent_02", "sequence cellar"]}
    assert json.loads((run / "summary.json").read_text())["one_frame"] == expected
    assert cli.main(["report", str(run)]) == 0
    page = unescape((run / "report" / "index.html").read_text())
    assert re.search(
        r"<span>agents in one frame</span><b>2 of 4</b><em>without a place: agent_02, sequence cellar</em>", page
    )
    assert "All agents in one frame" not in page


def test_a_sequence_without_an_agent_is_not_taken_for_the_agent_of_that_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the source's agent_00, agent_01 (dark) and agent_02 two agents are made: the run's agent_01 is the third."""
    met = [replace(drive(a, circuit(5.0 * a, 21.0)), source=f"agent_{2 * a:02d}") for a in range(2)]
    parts = met, (LeftOutEntry(sequence="agent_01", frames=42, reason="too dark"),)
    write(tmp_path, met)
    write_manifest(tmp_path, manifest(parts))
    run = tmp_path / "run"
    assert cli.main(["run", str(tmp_path), str(run), "--preset", "default", "--quiet"]) == 0
    summary = json.loads((run / "summary.json").read_text())
    assert summary["one_frame"] == {"agents": 2, "of": 3, "without": ["sequence agent_01"]}
    assert cli.main(["report", str(run)]) == 0
    page = unescape((run / "report" / "index.html").read_text())
    for said in (capsys.readouterr().out, page):
        assert "without a place: sequence agent_01" in said and "sequence agent_01: no agent, 42 frames" in said
        assert not re.search(r"without a place: agent_01|(?<!sequence )agent_01: no agent", said)


def test_a_team_in_one_frame_is_not_all_where_one_is_left_out(tmp_path: Path) -> None:
    parts = [drive(a, circuit(5.0 * a, 21.0)) for a in range(2)], LOSSES["an agent that never starts"].make()[1]
    write(tmp_path, parts[0])
    write_manifest(tmp_path, manifest(parts))
    assert cli.main(["run", str(tmp_path), str(tmp_path / "run"), "--preset", "default"]) == 0
    assert cli.main(["report", str(tmp_path / "run")]) == 0
    page = (tmp_path / "run" / "report" / "index.html").read_text()
    assert "2 of 3 agents in one frame" in page and "All agents in one frame" not in page


def test_without_metres_there_is_no_metre(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parts = LOSSES["one camera, two units"].make()
    write(tmp_path, parts[0])
    assert cli.main(["run", str(tmp_path), str(tmp_path / "run"), "--preset", "default", "--quiet"]) == 0
    assert cli.main(["report", str(tmp_path / "run")]) == 0
    page = (tmp_path / "run" / "report" / "index.html").read_text()
    assert not re.search(r">\s*metres\s*<", page) and not re.search(r"\d m\b", capsys.readouterr().out)


def test_the_page_shows_each_loss_with_the_words_of_the_outputs() -> None:
    rows = {row.split("|")[1].strip(): row for row in PAGE.read_text().splitlines() if row.startswith("| ")}
    for name, loss in LOSSES.items():
        assert name in rows, name
        assert all(words in rows[name] for words in (*loss.said, *loss.printed, *loss.shown)), name
        assert loss.tile[0] in rows[name], name
    assert (PAGE.parent / "index.md").read_text().count("losses.md") == 1


def test_the_manifest_is_what_the_folder_is_made_of(tmp_path: Path) -> None:
    """A folder written without ``left_out`` and ``doubtful`` is read: an older preprocessing's."""
    sequences, _ = LOSSES["no match"].make()
    write(tmp_path, sequences)
    content = json.loads((tmp_path / MANIFEST).read_text())
    del content["left_out"]
    for agent in content["agents"]:
        del agent["doubtful"]
    (tmp_path / MANIFEST).write_text(json.dumps(content))
    assert cli.main(["run", str(tmp_path), str(tmp_path / "run"), "--preset", "default", "--quiet"]) == 0
