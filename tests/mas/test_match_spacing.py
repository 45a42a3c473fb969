"""When the next match with the same agent is worth its bytes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factory import town

from maslam.backend.geometry import Sim3
from maslam.mas.config import OptimisationConfig
from maslam.mas.place_recognition.match_spacing import worth_after
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import MatchId
from maslam.mas.simulation import run
from maslam.mas.state.place_match import Match, MatchEnd

CONFIG = OptimisationConfig(match_sigma_depth=0.005)
DEPTH = 10.0
NOISE = np.sqrt(2.0) * 0.005 * DEPTH


def straight(way: float, off: float = 0.0, unit: float = 1.0) -> Match:
    """Two agents drive along z side by side; the match at ``way`` is ``off`` metres beside what odometry says."""
    pose = np.eye(4)
    pose[2, 3] = way / unit
    T_M_Q = Sim3(np.eye(3), np.array([(2.0 + off) / unit, 0.0, 0.0]))
    sure = 1e8 * np.eye(6)
    end = MatchEnd(0, pose, way)
    return Match(MatchId(1, round(way), 0, round(way)), end, end, T_M_Q, sure, 50, DEPTH / unit)


@pytest.mark.parametrize("unit", [1.0, 0.05], ids=["metres", "own unit"])
def test_matches_as_expected_make_the_way_longer_and_drift_makes_it_shorter(unit: float) -> None:
    """The floor of a match's noise is half a per cent of the depth, and here it is all the noise there is."""
    for off in (0.0, NOISE, 3.0 * NOISE, 10.0 * NOISE):
        expected = 3.5 * NOISE / (off + NOISE)
        found = worth_after(straight(0.0, unit=unit), straight(8.0, off, unit), CONFIG)
        assert found == pytest.approx(expected, rel=1e-6)


def test_it_does_not_matter_who_asked() -> None:
    earlier, latest = straight(0.0), straight(8.0, 0.2)
    assert worth_after(earlier.turned(), latest, CONFIG) == pytest.approx(worth_after(earlier, latest, CONFIG))


def test_a_noisy_match_tells_less() -> None:
    """One that is itself off by a metre bounds the drift worse, and the next one like it would say little sooner."""
    noisy = replace(straight(8.0, 0.2), information=np.eye(6))
    assert worth_after(straight(0.0), noisy, CONFIG) > worth_after(straight(0.0), straight(8.0, 0.2), CONFIG)


def accepted_with(most: int | None, drifting: float, folder: Path) -> tuple[int, float]:
    """Accepted matches and mean error of a run in which the gap may grow to ``most``."""
    config = preset("maslam")
    places = config.places.model_copy(update={"gap_keyframes": 3, "gap_most_keyframes": most, "closing_ends": False})
    manifest, sequences = town(2, 60, spacing_m=10.0, drifting=drifting)
    summary = run(manifest, sequences, config.model_copy(update={"places": places}), folder)
    assert summary.groups == [[0, 1]] and summary.ate_rmse_m.mean_agents is not None
    assert json.loads((folder / "summary.json").read_text())["matches"]["false_accepted"] == 0
    return summary.matches.accepted, summary.ate_rmse_m.mean_agents


def test_good_odometry_needs_fewer_matches(tmp_path: Path) -> None:
    always, error = accepted_with(None, 0.001, tmp_path / "a")
    grown, error_grown = accepted_with(24, 0.001, tmp_path / "b")
    assert grown <= 0.7 * always and error_grown < 1.1 * error


def test_drifting_odometry_is_matched_as_often_as_before(tmp_path: Path) -> None:
    share = []
    for drifting in (0.001, 0.1):
        always, _ = accepted_with(None, drifting, tmp_path / f"a{drifting}")
        grown, _ = accepted_with(24, drifting, tmp_path / f"b{drifting}")
        share.append(grown / always)
    assert share[1] > share[0] + 0.15


def test_drift_that_shows_brings_matches_closer_than_usual(tmp_path: Path) -> None:
    """Where odometry is good the least gap is not used: the usual one is enough to find that out."""
    found = {}
    for drifting in (0.001, 0.1):
        for least in (None, 2):
            config = preset("maslam")
            places = config.places.model_copy(
                update={"gap_keyframes": 6, "gap_least_keyframes": least, "closing_ends": False}
            )
            manifest, sequences = town(2, 60, spacing_m=10.0, drifting=drifting)
            folder = tmp_path / f"{drifting}_{least}"
            summary = run(manifest, sequences, config.model_copy(update={"places": places}), folder)
            found[drifting, least] = summary.matches.accepted
    assert found[0.1, 2] >= 1.3 * found[0.1, None]
    assert found[0.001, 2] <= found[0.001, None] + 1
