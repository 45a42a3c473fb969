"""When a kept tracking result counts as made from the same thing."""

import os
import shutil
from dataclasses import replace
from pathlib import Path

from maslam.frontend.config import OdometryConfig
from maslam.frontend.datasets import open_dataset
from maslam.tools.pipeline.tracking_cache import make_job


def test_whatever_changes_the_frames_changes_the_fingerprint(indoor_rgbd: Path, tmp_path: Path) -> None:
    sequence = open_dataset(indoor_rgbd).sequences[0]

    def fingerprint(of=sequence, **settings: int) -> str:
        return make_job(of, OdometryConfig(**settings), "default", None, tmp_path).fingerprint

    same = fingerprint()
    assert same == fingerprint(open_dataset(indoor_rgbd).sequences[0])
    others = {
        fingerprint(replace(sequence, depth_unit_m=2 * sequence.depth_unit_m)),
        fingerprint(replace(sequence, stamps_ns=sequence.stamps_ns + 1)),
        fingerprint(replace(sequence, left=sequence.left[:1] * len(sequence))),
        fingerprint(min_track_keyframes=3),
    }
    assert len(others) == 4 and same not in others


def test_an_image_that_changes_under_the_same_size_and_time_is_another(indoor_rgbd: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(indoor_rgbd, copy)
    sequence = open_dataset(copy).sequences[0]

    def fingerprint() -> str:
        return make_job(sequence, OdometryConfig(), "default", None, tmp_path).fingerprint

    same, image = fingerprint(), sequence.left[1]
    assert same == fingerprint()
    before, content = image.stat(), bytearray(image.read_bytes())
    content[-30] ^= 1
    image.write_bytes(content)
    os.utime(image, ns=(before.st_atime_ns, before.st_mtime_ns))
    after = image.stat()
    assert (after.st_size, after.st_mtime_ns) == (before.st_size, before.st_mtime_ns)
    assert fingerprint() != same
