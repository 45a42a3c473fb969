"""Commands compile what they need before workers begin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.kernels import odometry_kernels
from maslam.tools.common.progress import Silent
from maslam.tools.pipeline.preprocess import preprocess
from maslam.tools.pipeline.preprocess_options import PreprocessSettings


class Begun(Exception):
    """Workers would begin now."""


def test_kernels_are_ready_before_workers_begin(
    town_stereo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ready: list[Any] = []

    def begin(*_: object) -> None:
        raise Begun

    monkeypatch.setattr("maslam.tools.common.compiling.make_ready", lambda kernels, _: ready.extend(kernels))
    monkeypatch.setattr("maslam.tools.common.parallel.run_jobs", begin)
    with pytest.raises(Begun):
        preprocess(town_stereo, tmp_path / "out", PreprocessSettings(OdometryConfig(), workers=2), Silent())
    assert ready == odometry_kernels([RigKind.STEREO])


def test_what_is_tracked_needs_no_kernels(town_stereo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ready: list[Any] = []
    monkeypatch.setattr("maslam.tools.common.compiling.make_ready", lambda kernels, _: ready.extend(kernels))
    settings = PreprocessSettings(OdometryConfig(), workers=2)
    preprocess(town_stereo, tmp_path / "out", settings, Silent())
    ready.clear()
    preprocess(town_stereo, tmp_path / "out", settings, Silent())
    assert not ready
