"""An agent that lost tracking: its tracks become one where it sees the same place again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from factory import circuit, make_sequence, make_world, manifest_of

from maslam.backend.geometry import umeyama
from maslam.frontend.files.trajectory import read_tum
from maslam.mas.policies.presets import preset
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import run

DEFAULT = preset("default")


def joined_error_m(sequence: AgentSequence, folder: Path) -> float:
    """RMSE of the whole written trajectory, all tracks aligned together."""
    written = read_tum(folder / "agent_00" / "trajectory.tum")
    assert sequence.groundtruth is not None
    rows = np.searchsorted(sequence.groundtruth.stamps_ns, written.stamps_ns - 1000)
    truth = sequence.groundtruth.centres[rows]
    aligned = umeyama(truth, written.centres, False) @ written.centres
    return float(np.sqrt(((aligned - truth) ** 2).sum(axis=1).mean()))


def test_tracks_of_one_agent_are_joined_by_its_own_loop(tmp_path: Path) -> None:
    """It is carried back: what it sees again is a few seconds old, but of a track that nothing else links to this
    one."""
    way = np.concatenate([circuit(0.0, 30.0), circuit(6.0, 30.0)])
    alone = make_sequence(make_world(3), way, 3, 0, cuts=(60,))
    assert len(alone.tracks) == 2 and len(alone.keyframe_stamps_ns) == 40
    summary = run(manifest_of([alone]), [alone], DEFAULT, tmp_path / "run")
    assert summary.matches.own_loops >= 2 and summary.matches.false_accepted == 0
    assert summary.keyframes_placed == [40]
    assert len(read_tum(tmp_path / "run" / "agent_00" / "trajectory.tum")) == len(way)
    assert joined_error_m(alone, tmp_path / "run") < 0.3
    assert summary.traffic["total"].messages == 0


def test_three_tracks_are_joined_one_by_one(tmp_path: Path) -> None:
    way = np.concatenate([circuit(0.0, 24.0), circuit(9.0, 27.0), circuit(24.0, 24.0)])
    alone = make_sequence(make_world(7), way, 7, 0, cuts=(48, 102))
    summary = run(manifest_of([alone]), [alone], DEFAULT, tmp_path / "run")
    assert len(alone.tracks) == 3 and summary.keyframes_placed == [summary.keyframes]
    assert joined_error_m(alone, tmp_path / "run") < 0.3


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_pairs_of_tracks_that_are_apart_are_joined_in_turn(tmp_path: Path, scale: float) -> None:
    """Two places, each seen twice, by four tracks: all own loops are used, although no match joins the two pairs."""
    way = np.concatenate([circuit(0.0, 30.0), circuit(90.0, 24.0), circuit(6.0, 24.0), circuit(93.0, 21.0)])
    alone = make_sequence(make_world(3), way, 3, 0, cuts=(60, 108, 156), scale=scale)
    config = preset("maslam")
    rarely = config.optimisation.model_copy(update={"period_keyframes": 1000})  # only at the end, then both at once
    summary = run(manifest_of([alone]), [alone], config.model_copy(update={"optimisation": rarely}), tmp_path / "run")
    events = [json.loads(line) for line in (tmp_path / "run" / "events.jsonl").read_text().splitlines()]
    used = [e["matches"] for e in events if e["event"] == "optimised"]
    assert len(used) == 2 <= min(used) and sum(used) == summary.matches.own_loops
    assert summary.keyframes_placed == [36] and summary.matches.false_accepted == 0


def test_tracks_of_different_places_stay_apart(tmp_path: Path) -> None:
    way = np.concatenate([circuit(0.0, 30.0), circuit(90.0, 24.0)])
    alone = make_sequence(make_world(3), way, 3, 0, cuts=(60,))
    summary = run(manifest_of([alone]), [alone], DEFAULT, tmp_path / "run")
    assert summary.matches.own_loops == 0 and summary.keyframes_placed == [20]
