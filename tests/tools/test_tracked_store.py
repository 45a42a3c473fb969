"""When a kept tracking result counts as made from the same thing."""

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
