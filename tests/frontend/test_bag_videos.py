"""Compressed video in bags: pictures, where decoding begins, what is refused."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_makers import BASELINE_M, COUNT, HEIGHT, WIDTH
from h264_writer import changed_picture, key_picture, luma_of, parameters
from recording_makers import PACKET, VIDEO, Channel, header, video_message
from test_bags import P_RIGHT, RECEIVED, SCENE, STAMPS, info, messages, only, opened, packed, png, raw

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ImageSequence
from maslam.frontend.datasets.recordings.video_packets import codec_of
from maslam.frontend.datasets.stored_image import name_in
from maslam.frontend.errors import FrontendError

LEFT_HALF = [6 * row + column for row in range(4) for column in range(3)]  # of 6 x 4 blocks
KEYS = (0, 3)
SHOWN = np.stack([
    SCENE.images[i] if i in KEYS else np.hstack([SCENE.images[i, :, :48], SCENE.images[i // 3 * 3, :, 48:]])
    for i in range(COUNT)
])  # fmt: skip


def coded(images: np.ndarray = SCENE.images, repeated: bool = True) -> list[bytes]:
    """A packet a picture: whole at ``KEYS``, else only the left half anew; parameters with each key picture, or with
    the first one only."""
    packets = []
    for i, image in enumerate(images):
        if i in KEYS:
            head = parameters(WIDTH, HEIGHT) if repeated or i == 0 else b""
            packets.append(b"\x00\x00\x00\x01\x09\xf0" + head + key_picture(luma_of(image), i // 3))
        else:
            packets.append(changed_picture(luma_of(image), LEFT_HALF, i % 3))
    return packets


def video(
    topic: str, packets: Sequence[bytes], kind: str = VIDEO, named: str = "h264", stamps: Sequence[int] = STAMPS
) -> Channel:
    return Channel(
        topic, kind, RECEIVED[: len(packets)], lambda store, i: video_message(store, stamps[i], packets[i], named, kind)
    )


def check(sequence: ImageSequence, first: int = 0) -> None:
    for i in (4, 0, 5, 3, 1, 2, 2):
        if i >= first:
            shown = sequence.read_image(i - first).astype(int)
            np.testing.assert_allclose(shown, SHOWN[i], atol=2)  # the range of video has 220 levels


@pytest.mark.parametrize("name", ["run.bag", "sqlite3", "mcap", "mcap_message"])
@pytest.mark.parametrize(("kind", "named"), [(VIDEO, "h264"), (PACKET, "libx264"), (PACKET, "h264;yuv420p;bgr8;bgr8")])
@pytest.mark.parametrize("repeated", [True, False])
def test_pictures_are_those_that_were_coded(tmp_path: Path, name: str, kind: str, named: str, repeated: bool) -> None:
    channels = [
        video("/car/camera/image_raw/h264", coded(repeated=repeated), kind, named),
        info("/car/camera/camera_info"),
    ]
    sequence = only(tmp_path / name, channels)
    assert sequence.stamps_ns.tolist() == STAMPS and not sequence.problems
    check(sequence)
    check(pickle.loads(pickle.dumps(sequence)))  # noqa: S301 - our own; as for a worker process
    assert name_in(sequence.left[1], tmp_path).endswith(f"/car/camera/image_raw/h264/{STAMPS[1]}")
    assert sequence.read_colour(1).shape == (HEIGHT, WIDTH, 3)


def test_a_pair_of_videos(tmp_path: Path) -> None:
    channels = [
        video("/left/video", coded()),
        video("/right/video", coded(SCENE.rights)),
        info("/left/camera_info"),
        info("/right/camera_info", P=P_RIGHT),
    ]
    sequence = only(tmp_path / "mcap", channels)
    assert sequence.rig.kind is RigKind.STEREO and sequence.rig.baseline_m == pytest.approx(BASELINE_M)
    right = sequence.read(3).right
    assert right is not None
    np.testing.assert_allclose(right.astype(int), SCENE.rights[3], atol=2)


@pytest.mark.parametrize(
    "other",
    [
        raw("/camera/image_raw", SCENE.images, "mono8"),
        packed("/camera/image_raw/compressed", [png(image) for image in SCENE.images], "png"),
    ],
)
def test_images_of_their_own_come_before_video(tmp_path: Path, other: Channel) -> None:
    channels = [video("/camera/image_raw/ffmpeg", coded(), PACKET), other, info("/camera/camera_info")]
    sequence = only(tmp_path / "run.bag", channels)
    np.testing.assert_array_equal(sequence.read_image(1), SCENE.images[1])
    assert "not read: /camera/image_raw/ffmpeg (FFMPEGPacket, 6)" in sequence.origin


def test_pictures_before_the_first_key_picture_are_left_out(tmp_path: Path) -> None:
    packets = coded()
    channels = [video("/camera/video", packets[1:], stamps=STAMPS[1:]), info("/camera/camera_info")]
    sequence = only(tmp_path / "mcap", channels)
    assert sequence.stamps_ns.tolist() == STAMPS[3:]
    check(sequence, 3)
    assert "2 pictures before the first key picture cannot be decoded: left out" in messages(sequence)


@pytest.mark.parametrize(
    ("packets", "named", "stamps", "said"),
    [
        (coded(), "av1", STAMPS, r"/camera/video: video coded as 'av1', which is not read \(h264, h265\): republish"),
        (coded(), "h264", [STAMPS[i] for i in (0, 2, 1, 3, 5, 4)], r"2 of its times go back: .* \(B frames\)"),
        (coded()[1:3], "h264", STAMPS, "no key picture, from which decoding can begin, in 2 messages"),
        ([b"\x00\x00\x01\x65abc"] * 6, "h264", STAMPS, r"/camera/video at \d+ ns: (cannot be decoded|0 pictures)"),
    ],
)
def test_what_is_not_read_is_one_line(
    tmp_path: Path, packets: list[bytes], named: str, stamps: list[int], said: str
) -> None:
    with pytest.raises(FrontendError, match=said):
        opened(
            tmp_path / "mcap",
            [video("/camera/video", packets, named=named, stamps=stamps), info("/camera/camera_info")],
        )


def test_messages_of_an_unknown_kind_are_named_with_a_cure(tmp_path: Path) -> None:
    kind = "theora_image_transport/msg/Packet"

    def make(store: Any, i: int) -> Any:
        return store.types[kind](header=header(store, STAMPS[i]), data=np.zeros(8, np.uint8), b_o_s=0)

    with pytest.raises(
        FrontendError, match=r"no image topic .*; /camera/image_raw/theora seems to hold images .* republish"
    ):
        opened(tmp_path / "run.bag", [Channel("/camera/image_raw/theora", kind, RECEIVED, make)])


def test_depth_is_never_a_video(tmp_path: Path) -> None:
    channels = [
        raw("/camera/color/image_raw", SCENE.images, "mono8"),
        info("/camera/color/camera_info"),
        video("/camera/aligned_depth_to_color/image_raw/ffmpeg", coded(), PACKET),
    ]
    assert only(tmp_path / "run.bag", channels).rig.kind is RigKind.MONO


@pytest.mark.parametrize(
    ("named", "codec"),
    [("h264", "h264"), ("hevc_nvenc", "h265"), ("libx265;yuv420p", "h265"), ("h264_vaapi", "h264"), ("vp9", None)],
)
def test_names_of_codecs(named: str, codec: str | None) -> None:
    assert codec_of(named) == codec


@pytest.mark.parametrize("name", ["run.bag", "mcap"])
def test_compressed_images_that_hold_video(tmp_path: Path, name: str) -> None:
    """Some drivers send h264 in sensor_msgs/CompressedImage."""
    channels = [packed("/camera/image_raw/compressed", coded(), "h264"), info("/camera/camera_info")]
    check(only(tmp_path / name, channels))
