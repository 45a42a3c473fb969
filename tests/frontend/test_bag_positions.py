"""NavSatFix messages in bags are positions of the robot whose images they are recorded with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags")
from dataset_makers import FX, HEIGHT, WIDTH, make_scene
from recording_makers import IMAGE, INFO, Channel, header, image_message, info_message, write_ros1, write_ros2

from maslam.frontend.datasets import open_dataset
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.geodesy import enu_of
from maslam.frontend.recording_config import RecordingConfig
from maslam.tools.cli import main
from maslam.tools.common.found_positions import NO_POSITIONS, PositionSettings
from maslam.tools.inspection.command import inspect_dataset
from maslam.tools.pipeline.positions import with_positions

SCENE = make_scene()
STAMPS = [int(t) for t in SCENE.stamps_ns]
K = np.array([[FX, 0, WIDTH / 2], [0, FX, HEIGHT / 2], [0, 0, 1.0]])
FIX = "sensor_msgs/msg/NavSatFix"
PLACE = np.array([48.0, 11.5, 500.0])


def fix_message(store: Any, stamp_ns: int, place: np.ndarray, status: int = 0, sigma: float = 0.0) -> Any:
    kinds = store.types
    return kinds[FIX](
        header=header(store, stamp_ns, "gps"),
        status=kinds["sensor_msgs/msg/NavSatStatus"](status=status, service=1),
        latitude=float(place[0]),
        longitude=float(place[1]),
        altitude=float(place[2]),
        position_covariance=np.diag([sigma**2, 4 * sigma**2, 9 * sigma**2]).ravel(),
        position_covariance_type=2 if sigma else 0,
    )


def at(i: int) -> np.ndarray:
    return PLACE + np.array([0.0, 1e-5 * i, 0.1 * i])


def images(robot: str = "") -> list[Channel]:
    pictures = [cv2.resize(image, (WIDTH, HEIGHT)) for image in SCENE.images]
    image = lambda store, i: image_message(store, STAMPS[i], pictures[i], "mono8")  # noqa: E731
    info = lambda store, i: info_message(store, STAMPS[i], (WIDTH, HEIGHT), K)  # noqa: E731
    return [
        Channel(f"{robot}/camera/image_raw", IMAGE, STAMPS, image),
        Channel(f"{robot}/camera/camera_info", INFO, STAMPS, info),
    ]


def fixes(topic: str, late_ns: int = 0, **kept: Any) -> Channel:
    return Channel(topic, FIX, STAMPS, lambda s, i: fix_message(s, STAMPS[i] + late_ns, at(i), **kept))


def placed(path: Path, settings: PositionSettings = NO_POSITIONS) -> tuple[Any, list[str]]:
    dataset, _, lines = with_positions(open_dataset(path), settings, None)
    return dataset.sequences, lines


@pytest.mark.parametrize("ros", [1, 2])
def test_they_are_metres_around_the_first_with_the_receivers_noise(ros: int, tmp_path: Path) -> None:
    path = tmp_path / ("drive.bag" if ros == 1 else "drive")
    (write_ros1 if ros == 1 else write_ros2)(path, [*images(), fixes("/gps/fix", sigma=0.5)])
    [sequence], lines = placed(path)
    found = sequence.positions
    assert found.stamps_ns.tolist() == STAMPS and found.geodetic is None
    np.testing.assert_allclose(found.enu, enu_of(np.array([at(i) for i in range(len(STAMPS))]), PLACE), atol=1e-6)
    np.testing.assert_allclose(found.sigma, np.tile([0.5, 1.0, 1.5], (len(STAMPS), 1)))
    assert lines == [f"{sequence.name}: 6 of 6 positions in /gps/fix while images are"]


def test_settings_complete_what_the_receiver_does_not_tell(tmp_path: Path) -> None:
    write_ros2(tmp_path / "drive", [*images(), fixes("/fix")])
    [sequence], _ = placed(tmp_path / "drive", PositionSettings(offset_s=0.01, sigma_m=3.0, antenna_m=None))
    np.testing.assert_allclose(sequence.positions.sigma[0], [3.0, 3.0, 6.0])
    assert sequence.positions.stamps_ns[0] == STAMPS[0] + 10_000_000


def test_messages_without_a_fix_and_at_other_times_are_said_and_no_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = Channel("/fix", FIX, STAMPS, lambda s, i: fix_message(s, STAMPS[i], at(i), -1 if i < 2 else 0))
    write_ros2(tmp_path / "some", [*images(), lost])
    _, lines = placed(tmp_path / "some")
    assert lines[0].endswith("4 of 4 positions in /fix while images are")
    assert lines[1].endswith("/fix: 2 of 6 messages without a fix left out")
    write_ros2(tmp_path / "none", [*images(), fixes("/fix", status=-1)])
    [sequence], lines = placed(tmp_path / "none")
    assert sequence.positions is None and lines == []
    assert any("/fix: no positions: 6 of 6 messages without a fix" in note for note in sequence.notes)
    write_ros2(tmp_path / "late", [*images(), fixes("/fix", late_ns=10**12)])
    [sequence], [line] = placed(tmp_path / "late")
    assert sequence.positions is None and "not used: positions" in line and "--gps-offset" in line
    assert main(["inspect", str(tmp_path / "late")]) == 0
    assert "/fix: not used: positions" in capsys.readouterr().out


def test_each_robot_has_those_of_its_own_name(tmp_path: Path) -> None:
    channels = [*images("/alice"), *images("/bob"), fixes("/bob/gps/fix"), fixes("/base/fix")]
    write_ros2(tmp_path / "team", channels)
    alice, bob = open_dataset(tmp_path / "team").sequences
    assert alice.positions is None and bob.positions is not None
    assert bob.positions.source.endswith(": /bob/gps/fix")


def test_of_several_one_is_named_or_none(tmp_path: Path) -> None:
    write_ros2(tmp_path / "drive", [*images(), fixes("/gps/fix"), fixes("/rtk/fix", sigma=0.01)])
    [sequence] = open_dataset(tmp_path / "drive").sequences
    assert sequence.positions is None
    assert any("several topics of positions (/gps/fix (6), /rtk/fix (6))" in p.message for p in sequence.problems)
    read = lambda topic: open_dataset(tmp_path / "drive", recording=RecordingConfig(gps_topic=topic)).sequences[0]  # noqa: E731
    assert read("/rtk/fix").positions.sigma[0, 0] == pytest.approx(0.01)
    assert read("none").positions is None and read("none").problems == ()
    with pytest.raises(FrontendError, match="no topic of positions sonar: there are /gps/fix, /rtk/fix"):
        read("sonar")


def test_inspect_shows_them(tmp_path: Path) -> None:
    write_ros2(tmp_path / "drive", [*images(), fixes("/gps/fix")])
    [one] = inspect_dataset(tmp_path / "drive").sequences
    assert one.positions.startswith("6 of 6 positions in /gps/fix while images are") and "in degrees" in one.positions
