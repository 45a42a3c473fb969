"""GPS in a team: 2 km of odometry that is 2 % too long, positions once a second with 2 m of noise."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factory import DIM, MODEL, SHA256, World, _track, manifest_of

from maslam._replaced import replaced
from maslam.backend.config import SolverConfig
from maslam.backend.geometry import rotation_angle_deg, se3, se3_inverse, so3_exp, transform_points
from maslam.descriptors.container import PlaceVectors
from maslam.frontend.files.geodesy import enu_of
from maslam.frontend.files.positions import PositionFixes
from maslam.frontend.files.trajectory import Trajectory, read_tum
from maslam.mas.evaluation.georeference import MeasuredPoints, fit_frame
from maslam.mas.evaluation.summary import Summary
from maslam.mas.policies.presets import preset
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import run
from maslam.mas.state.positions import not_used
from maslam.tools.report.summary_table import table_of

STEP_M, COUNT, SIGMA_M, ANTENNA = 5.0, 400, 2.0, np.array([0.5, -1.5, -0.4])
T_ENU_W = se3(so3_exp([0.0, 0.0, 2.2]) @ so3_exp([1.5707963, 0.0, 0.0]), [1000.0, 200.0, 40.0])


def path() -> np.ndarray:
    T, turn, rng = [np.eye(4)], 0.0, np.random.default_rng(1)
    for _ in range(COUNT - 1):
        turn = 0.9 * turn + 0.02 * rng.standard_normal()
        T.append(T[-1] @ se3(so3_exp([0.0, turn, 0.0]), [0.0, 0.0, STEP_M]))
    return np.array(T)


TRUTH = path()


def drifted(truth: np.ndarray, longer: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = [np.eye(4)]
    for k in range(len(truth) - 1):
        step = se3_inverse(truth[k]) @ truth[k + 1]
        step[:3, 3] *= 1.0 + longer
        turn = so3_exp([0.0, 3e-5, 0.0]) @ so3_exp(2e-4 * rng.standard_normal(3))
        out.append(out[-1] @ step @ se3(turn, 0.01 * rng.standard_normal(3)))
    return np.array(out)


def fixes(truth: np.ndarray, stamps_ns: np.ndarray, seed: int) -> PositionFixes:
    """At 10 m/s a fix every second key-frame, between two of them."""
    rng = np.random.default_rng(seed)
    rows = np.arange(0, len(truth) - 1, 2)
    antenna = np.array([transform_points(T_ENU_W @ T, ANTENNA[None])[0] for T in truth])
    middle = 0.5 * (antenna[rows] + antenna[rows + 1]) + SIGMA_M * rng.standard_normal((len(rows), 3))
    wrong = rng.random(len(rows)) < 0.05
    middle[wrong] += rng.choice([-1, 1], (int(wrong.sum()), 3)) * 80.0
    stamps = (stamps_ns[rows] + stamps_ns[rows + 1]) // 2
    return PositionFixes(stamps, middle, np.full((len(rows), 3), SIGMA_M), ANTENNA)


def sequence(number: int, longer: float, gps: bool, seed: int) -> AgentSequence:
    """An agent on the common path whose odometry is longer by a share; its key-frames show a common world."""
    rng = np.random.default_rng(seed)
    world = WORLD
    odometry, stamps = drifted(TRUTH, longer, seed), 500_000_000 * np.arange(COUNT)
    track = _track(world, TRUTH, odometry, stamps / 1e9, rng, np.ones(COUNT), 60, 0.02)
    vectors = PLACES + 0.02 * rng.standard_normal(PLACES.shape)
    unit = (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)
    return AgentSequence(
        name=f"agent_{number:02d}",
        tracks=(track,),
        places=PlaceVectors(MODEL, SHA256, DIM, stamps, unit, np.ones(COUNT, dtype=bool)),
        trajectory=Trajectory(stamps, odometry),
        metric=True,
        start_ns=0,
        source=f"agent_{number:02d}",
        groundtruth=Trajectory(stamps, TRUTH),
        positions=fixes(TRUTH, stamps, 50 + seed) if gps else None,
    )


def _world() -> World:
    rng = np.random.default_rng(3)
    local = rng.uniform([-9, -4, 3], [9, 1.5, 22], (COUNT, 40, 3))
    points = np.concatenate([transform_points(T, p) for T, p in zip(TRUTH, local, strict=True)])
    count = len(points)
    descriptors = rng.integers(0, 256, (count, 32), dtype=np.uint8)
    return World(points, descriptors, rng.integers(0, 10_000, count).astype(np.int32), rng.normal(size=(DIM, 4)), None)


WORLD = _world()
PLACES = np.random.default_rng(4).standard_normal((COUNT, DIM))
PLACES /= np.linalg.norm(PLACES, axis=1, keepdims=True)


def from_start_m(track: np.ndarray) -> float:
    """Root mean square error of positions that begin where the truth begins."""
    return float(np.sqrt(((track[:, :3, 3] - TRUTH[:, :3, 3]) ** 2).sum(axis=1).mean()))


DATUM = [48.0, 11.0, 500.0]


def played(
    sequences: list[AgentSequence], folder: Path, datum: list[float] | None = None, **changes: object
) -> Summary:
    config = preset("maslam")
    config = config.model_copy(update={"optimisation": config.optimisation.model_copy(update=changes)})
    manifest = manifest_of(sequences)
    if datum is not None:
        manifest = manifest.model_copy(update={"settings": {"gps": {"origin": datum}}})
    return run(manifest, sequences, config, folder)


def assert_on_earth(folder: Path) -> None:
    """Positions within a metre, and turned right within a degree, of the truth in the frame of the positions."""
    there = read_tum(folder / "trajectory_enu.tum")
    truth = T_ENU_W @ TRUTH
    assert len(there) == COUNT
    assert np.sqrt(((there.centres - truth[:, :3, 3]) ** 2).sum(axis=1).mean()) < 1.0
    assert rotation_angle_deg(np.swapaxes(truth[:, :3, :3], 1, 2) @ there.poses[:, :3, :3]).max() < 1.0


def test_one_agent_alone_loses_its_drift(tmp_path: Path) -> None:
    alone = sequence(0, 0.02, True, 1)
    before = from_start_m(alone.tracks[0].poses)
    assert before > 10.0
    summary = played([alone], tmp_path / "run")
    assert summary.ate_rmse_m.agents[0] < 0.1 * before
    assert_on_earth(tmp_path / "run" / "agent_00")
    assert not (tmp_path / "run" / "agent_00" / "trajectory_geodetic.csv").exists()
    assert summary.positions is not None and summary.positions.used
    assert summary.positions.datum is None
    (group,) = summary.positions.groups
    # One in twenty is 80 m off in each axis; the others have 2 m in each, of two and of one.
    assert group.positions == COUNT // 2 and 3 <= group.far_off <= 20
    assert group.rms_horizontal_m == pytest.approx(2.0 * np.sqrt(2.0), rel=0.2)
    assert group.rms_vertical_m == pytest.approx(2.0, rel=0.2)
    # Without them it stays as it was.
    ignored = played([alone], tmp_path / "without", positions=False)
    assert ignored.positions is not None and not ignored.positions.used
    assert ignored.ate_rmse_m.agents[0] > 4.0 * summary.ate_rmse_m.agents[0]


def test_an_agent_without_positions_gains_by_its_matches(tmp_path: Path) -> None:
    team = [sequence(0, 0.02, True, 1), sequence(1, 0.015, False, 2)]
    before = [from_start_m(one.tracks[0].poses) for one in team]
    summary = played(team, tmp_path / "run", DATUM)
    assert summary.matches.accepted > 10
    for name in ("agent_00", "agent_01"):
        assert_on_earth(tmp_path / "run" / name)
        table = np.loadtxt(tmp_path / "run" / name / "trajectory_geodetic.csv", delimiter=",", skiprows=1)
        there = read_tum(tmp_path / "run" / name / "trajectory_enu.tum")
        np.testing.assert_allclose(enu_of(table[:, 1:], np.array(DATUM)), there.centres, atol=1e-3)
    assert summary.positions is not None and summary.positions.datum is not None
    assert summary.positions.datum.altitude_m == 500.0
    assert max(a / b for a, b in zip(summary.ate_rmse_m.agents, before, strict=True)) < 0.1


def test_without_an_elected_agent_too_positions_bend_who_has_none(tmp_path: Path) -> None:
    team = [sequence(0, 0.02, True, 1), sequence(1, 0.015, False, 2)]
    before = [from_start_m(one.tracks[0].poses) for one in team]
    seldom = {"period_keyframes": 40}  # what is asked is where they end
    summary = played(team, tmp_path / "run", solver=SolverConfig(method="multifrontal", start="warm"), **seldom)
    assert summary.positions is not None and summary.positions.used
    assert max(a / b for a, b in zip(summary.ate_rmse_m.agents, before, strict=True)) < 0.1
    for name in ("agent_00", "agent_01"):
        assert_on_earth(tmp_path / "run" / name)


def test_what_the_solver_leaves_aside_is_said(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    alone = sequence(0, 0.02, True, 1)
    solver = SolverConfig(method="dgs", length_sigma=0.01)
    config = preset("maslam")
    settings = config.optimisation.model_copy(update={"solver": solver})
    assert not not_used(config.optimisation, True)
    positions, lengths = not_used(settings, True)
    assert "positions (GPS) are not used: method dgs" in positions and "two-level" in positions
    assert "length_sigma is not used" in lengths and "method elected" in lengths
    assert not_used(settings, False) == [lengths]
    robust = config.optimisation.model_copy(update={"solver": replaced(config.optimisation.solver, robust="gnc")})
    assert "with robust gnc" in not_used(robust, True)[0]
    with caplog.at_level(logging.WARNING):
        played([alone], tmp_path / "run", solver=solver)
    assert positions in caplog.text and lengths in caplog.text


def test_a_frame_is_laid_on_positions_whatever_its_unit() -> None:
    """Against the transform that made them; each axis counts by its own noise, and one in ten positions is wrong."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-50, 50, (300, 3)) * [1.0, 0.2, 1.0]
    R, t = so3_exp([0.4, -1.2, 0.3]), np.array([400.0, -20.0, 7.0])
    sigma = np.tile([0.5, 0.5, 20.0], (300, 1))
    enu = 2.5 * points @ R.T + t + sigma * rng.standard_normal((300, 3))
    enu[::10] += [60.0, -60.0, 0.0]
    fit = fit_frame(MeasuredPoints(points, enu, sigma), True)
    T, distance, turn = fit.T_E_F, fit.distance, fit.rotation_sigma
    np.testing.assert_allclose(T.scale, 2.5, rtol=0.005)
    assert rotation_angle_deg(R.T @ T.rotation) < 3.0 * np.degrees(turn)
    np.testing.assert_allclose((T.translation - t)[:2], 0.0, atol=0.3)
    assert distance[::10].min() > 10.0 > np.delete(distance, np.s_[::10]).max()


def test_positions_on_a_line_do_not_tell_how_the_map_is_turned() -> None:
    # Far from the origin each turn moves them a lot, but a shift undoes that.
    points = np.arange(40.0)[:, None] * [0.0, 0.0, 1.0] + np.array([300.0, -200.0, 0.0])
    for aside, known in ((0.0, False), (10.0, True)):
        bent = points + np.where(np.arange(40) > 20, aside, 0.0)[:, None] * [1.0, 0.0, 0.0]
        turned = bent @ so3_exp([0.0, 0.0, 1.0]).T
        turn = fit_frame(MeasuredPoints(bent, turned, np.full((40, 3), 0.5)), False).rotation_sigma
        assert bool(np.degrees(turn) < 5.0) is known


@pytest.mark.parametrize(
    ("factor", "sigma_m", "unit"),
    [
        (1e3, SIGMA_M, "millimetres"),
        (1e2, SIGMA_M, "centimetres"),
        (1e-3, SIGMA_M, "kilometres"),
        (1.0, SIGMA_M, ""),
        (1e3, 1e6, ""),
    ],
)
def test_positions_that_cannot_be_metres_are_named_with_their_unit(
    factor: float, sigma_m: float, unit: str, tmp_path: Path
) -> None:
    """Noise above the size of the map has no unit to tell."""
    one = sequence(0, 0.0, True, 7)
    fixed = one.positions
    assert fixed is not None
    fixed = replace(fixed, enu=fixed.enu * factor, sigma=np.full_like(fixed.sigma, sigma_m))
    summary = played([replace(one, positions=fixed)], tmp_path / "run", positions=False)
    assert summary.positions is not None
    (group,) = summary.positions.groups
    assert (f"in {unit}? metres are meant" in group.reason) is bool(unit)
    assert ("times as far apart as the map" in table_of(tmp_path / "run")) is bool(unit)
