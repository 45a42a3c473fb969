"""Images in, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from maslam.frontend import datasets
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import Dataset, ReadingConfig
from maslam.frontend.datasets.readers import ReaderLike
from maslam.frontend.recording_config import RecordingConfig
from maslam.tools.pipeline.preprocess_options import READING

from .common import PathLike, Settings, changed, nested, rig_kind


def open_dataset(
    path: PathLike,
    *,
    rig: RigKind | str | None = None,
    dataset: str | None = None,
    readers: Sequence[ReaderLike] = (),
    strict: bool = True,
    settings: Settings | None = None,
) -> Dataset:
    """Open a folder of images: a data set of any kind that ``docs/datasets.md`` lists, any folder of images with a
    camera file, a film, a bag of ROS 1 or ROS 2, or a folder of several robots.

    Nothing is decoded yet: ``for frame in dataset.sequences[0].frames()`` decodes and rectifies.

    Args:
        path: the folder, or the recording.
        rig: ``"mono"``, ``"stereo"`` or ``"rgbd"``: use only this much of the sensors; None takes all there is.
        dataset: the kind to read it as, ours or an entry point of ``maslam.datasets``; None takes the first that
            recognises it.
        readers: readers of your own (:class:`maslam.Reader`), tried before all others.
        strict: raise the first problem that would spoil a run; otherwise problems are listed in each sequence.
        settings: what of a recording is read, ``{"start_s": 30, "stride": 2}``, and how images are,
            ``{"images.masks": "masks"}``.

    Raises:
        MaslamError: no such folder, nothing that is known in it, or (``strict``) data that cannot be used.
    """
    content = nested(settings)
    reading = changed(ReadingConfig(), content.pop(READING, {}))
    recording = changed(RecordingConfig(), content)
    return datasets.open_dataset(Path(path), rig_kind(rig), strict, readers, dataset, recording, reading)
