"""When the next match with the same agent is worth its bytes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from factory import town

from maslam.backend.geometry import Array, Sim3
from maslam.mas.config import OptimisationConfig
from maslam.mas.place_recognition.match_spacing import DriftAlong, MeasuredDrift
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import MatchId
from maslam.mas.simulation import run
from maslam.mas.state.place_match import Match, MatchEnd

CONFIG = OptimisationConfig(match_sigma_depth=0.005, odometry_sigma_deg=1e-6, match_sigma_deg=1e-6)
DEPTH = 10.0
STEP = 1.5


def straight(key: int, off: Array, unit: float = 1.0) -> Match:
    """Two agents drive along z side by side, a key-frame each step; the match of two key-frames says that the second
    one's odometry has drifted by ``off``."""
    pose = np.eye(4)
    pose[2, 3] = key * STEP / unit
    T_M_Q = Sim3(np.eye(3), (np.array([2.0, 0.0, 0.0]) + off) / unit)
    end = MatchEnd(0, pose, key * STEP / unit)
    return Match(MatchId(1, key, 0, key), end, end, T_M_Q, np.diag([1e8] * 3 + [1e12] * 3), 50, DEPTH / unit)


def driven(level: float, length: float = 0.0, noise: float = 0.5, unit: float = 1.0, seed: int = 0) -> list[Match]:
    """A match every four key-frames, its noise ``noise`` times what is stated; odometry of both drifts by white noise
    of ``level`` times what is stated, and one is too long by the share ``length``."""
    rng = np.random.default_rng(seed)
    sigma = level * np.sqrt(2.0) * (0.003 * STEP + 0.0005 * DEPTH)
    along = np.array([0.0, 0.0, length * STEP])
    drift = np.cumsum(sigma * rng.standard_normal((400, 3)) + along, axis=0)
    each = noise * CONFIG.match_sigma_depth * DEPTH
    return [straight(k, drift[k] + each * rng.standard_normal(3), unit) for k in range(0, 400, 4)]


@pytest.mark.parametrize("unit", [1.0, 0.05], ids=["metres", "own unit"])
@pytest.mark.parametrize("noise", [0.3, 1.0], ids=["surer than stated", "as stated"])
def test_drift_is_measured_apart_from_the_matches_noise(noise: float, unit: float) -> None:
    for level in (0.0, 1.0, 2.0):
        found = MeasuredDrift(CONFIG).share(driven(level, noise=noise, unit=unit), 0)
        assert found == pytest.approx(level**2, rel=0.35, abs=0.12)


def test_it_does_not_matter_who_asked_nor_in_which_order_matches_came() -> None:
    matches = driven(1.0)
    found = MeasuredDrift(CONFIG).share(matches, 0)
    assert MeasuredDrift(CONFIG).share([m.turned() for m in matches[::-1]], 0) == pytest.approx(found)


def test_wrong_lengths_are_drift_too() -> None:
    """It takes matches to find them, also where an optimisation looks for them."""
    right, wrong = driven(0.0), driven(0.0, length=0.015)
    assert MeasuredDrift(CONFIG).share(right, 0) < 0.05 < MeasuredDrift(CONFIG).share(wrong, 0)


def test_one_wrong_match_is_not_taken_for_drift_without_bound() -> None:
    matches = driven(0.0)
    matches[50] = straight(200, np.array([1e3, 0.0, 0.0]))
    assert MeasuredDrift(CONFIG).share(matches, 0) < 25.0


def test_between_two_matches_less_is_unknown_than_after_the_last() -> None:
    """Of a Brownian bridge: half as much in the middle as at the end of one side."""
    along = DriftAlong([(0, 10), (20, 30)], 0.01, 0.5, STEP, DEPTH, CONFIG)
    after = along.at(30, 40)
    assert after == pytest.approx(along.over(10, 10)) and after > 0
    assert along.at(10, 20) == pytest.approx(after / 2.0)
    assert along.at(20, 30) == 0.0 and along.close(22, 3) and not along.close(10, 3)


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
    """Where odometry is exact the least gap is not used: the usual one is enough to find that out."""
    found = {}
    for drifting in (0.0, 0.1):
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
    assert found[0.0, 2] <= found[0.0, None] + 1
