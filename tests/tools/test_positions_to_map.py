"""GPS from images to a map on the Earth: receivers with a clock, a frame and an antenna of their own."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import maslam
from maslam.backend.geometry import rotation_angle_deg, se3, so3_exp, transform_points
from maslam.errors import MaslamError
from maslam.frontend.files.geodesy import enu_of, geodetic_of
from maslam.frontend.files.trajectory import read_kitti_poses, read_tum
from maslam.tools import cli

ORIGIN, SIGMA_M = np.array([-33.9, 151.2, 40.0]), np.array([0.004, 0.004, 0.01])
T_E_W = se3(so3_exp([0.0, 0.0, 2.0]) @ so3_exp([-np.pi / 2, 0.0, 0.0]), [800.0, -300.0, 12.0])
"""The rendered world (y down) in the frame of the positions (up)."""
ANTENNA, CLOCK_S = np.array([0.3, -1.2, -0.5]), 1_700_000_000.0
NAMES = ("agent_00", "agent_01")


def truth_of(town: Path, name: str) -> np.ndarray:
    return np.asarray(T_E_W @ read_kitti_poses(town / name / "poses.txt")[1])


@pytest.fixture(scope="module")
def fixes(town_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of messages of each agent's receiver: ten a second, between the images, as degrees and covariances."""
    folder, rng = tmp_path_factory.mktemp("gps"), np.random.default_rng(3)
    for name in NAMES:
        times = np.loadtxt(town_stereo / name / "times.txt")
        antenna = np.array([transform_points(T, ANTENNA[None])[0] for T in truth_of(town_stereo, name)])
        at = 0.5 * (times[:-1] + times[1:])
        noisy = 0.5 * (antenna[:-1] + antenna[1:]) + SIGMA_M * rng.standard_normal((len(at), 3))
        rows = [
            f"{round((t + CLOCK_S) * 1e9)},0,{lat!r},{lon!r},{alt!r},{','.join(map(repr, (SIGMA_M**2).tolist()))}\n"
            for t, (lat, lon, alt) in zip(at.tolist(), geodetic_of(noisy, ORIGIN).tolist(), strict=True)
        ]
        head = "field.header.stamp,field.status.status,field.latitude,field.longitude,field.altitude,"
        head += "field.position_covariance0,field.position_covariance4,field.position_covariance8\n"
        (folder / f"{name}.csv").write_text(head + "".join(rows))
    return folder


def test_images_and_positions_become_a_map_on_the_earth(
    town_stereo: Path, fixes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--gps", str(fixes), f"--gps-offset={-CLOCK_S}", "--gps-antenna", ",".join(map(str, ANTENNA))]
    out = tmp_path / "out"
    assert cli.main(["slam", str(town_stereo), str(out), *words, "--workers", "1", "--quiet"]) == 0
    summary = json.loads((out / "summary.json").read_text())
    (group,) = summary["positions"]["groups"]
    assert group["agents"] == [0, 1]
    assert group["positions"] >= 30
    datum = [summary["positions"]["datum"][f"{key}"] for key in ("latitude_deg", "longitude_deg", "altitude_m")]
    assert enu_of(np.array([datum]), ORIGIN)[0] == pytest.approx(T_E_W[:3, 3], abs=200.0)  # the first fix
    assert "positions, 0.0" in capsys.readouterr().out
    for name in NAMES:
        truth, folder = truth_of(town_stereo, name), out / name
        found = read_tum(folder / "trajectory_enu.tum")
        table = np.loadtxt(folder / "trajectory_geodetic.csv", delimiter=",", skiprows=1)
        assert len(found) == len(table) == len(truth)
        turned = rotation_angle_deg(np.swapaxes(truth[:, :3, :3], 1, 2) @ found.poses[:, :3, :3])
        assert turned.max() < 3.0 * group["rotation_sigma_deg"] < 4.0
        # The camera's, not the antenna's.
        assert np.linalg.norm(enu_of(table[:, 1:], ORIGIN) - truth[:, :3, 3], axis=1).max() < 0.05
        np.testing.assert_allclose(enu_of(table[:, 1:], np.array(datum)), found.centres, atol=1e-3)
        np.testing.assert_allclose(table[:, 0], np.loadtxt(town_stereo / name / "times.txt"), atol=1e-6)
    # Python takes the same arguments, and makes the same of them.
    antenna = (float(ANTENNA[0]), float(ANTENNA[1]), float(ANTENNA[2]))
    told = {"gps": fixes, "gps_offset_s": -CLOCK_S, "gps_antenna_m": antenna}
    maslam.preprocess(town_stereo, out / "sequences", **told)  # type: ignore[arg-type]
    seen = (out / "sequences" / "agent_00" / "gps.csv").read_text()
    maslam.preprocess(town_stereo, out / "sequences", overwrite=True)
    assert not (out / "sequences" / "agent_00" / "gps.csv").exists()
    maslam.preprocess(town_stereo, out / "sequences", overwrite=True, **told)  # type: ignore[arg-type]
    assert (out / "sequences" / "agent_00" / "gps.csv").read_text() == seen
    with pytest.raises(MaslamError, match="gps_sigma_m: metres above 0 are meant"):
        maslam.preprocess(town_stereo, out / "sequences", gps=fixes, gps_sigma_m=0.0)
    with pytest.raises(MaslamError, match="--gps-offset shifts"):
        maslam.slam(town_stereo, tmp_path / "other", gps=fixes)
