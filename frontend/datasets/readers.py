"""Which readers are tried for a folder, and in which order."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from maslam.extensions import ExtensionGroup, check_name, installed, load_extension, made, name_of

from ..recording_config import RecordingConfig
from .associations import AssociationsReader
from .base import Reader
from .euroc import EurocReader
from .folder import FolderReader
from .kitti import KittiReader
from .kitti_raw import KittiRawReader
from .nerfstudio import NerfstudioReader
from .openloris import OpenLorisReader
from .recordings.bags import BagReader
from .recordings.films import FilmReader
from .replica import ReplicaReader
from .scannet import ScanNetReader
from .seven_scenes import SevenScenesReader
from .tartanair import TartanAirReader
from .tum import TumReader
from .tum_vi import TumViReader

ReaderLike = Reader | type[Reader] | Callable[[], Reader]
"""A reader, or what makes one."""
OURS: tuple[Reader, ...] = (
    KittiReader(),
    EurocReader(),
    TumReader(),
    SevenScenesReader(),
    TumViReader(),
    KittiRawReader(),
    AssociationsReader(),
    ReplicaReader(),
    ScanNetReader(),
    TartanAirReader(),
    OpenLorisReader(),
    NerfstudioReader(),
    BagReader(),
    FilmReader(),
)
"""Tried in this order."""
ANY_IMAGES = FolderReader()
"""Takes any folder of images, so it comes last."""


def choose_readers(
    given: Iterable[ReaderLike], kind: str | None, recording: RecordingConfig | None = None
) -> tuple[Reader, ...]:
    """The readers to try: ``given``, ours, those of entry points (by name), the one for any folder of images; with
    ``kind`` only the one of that name."""
    own = [_made(name_of(one), one) for one in given]
    ours = [BagReader(recording) if isinstance(reader, BagReader) else reader for reader in OURS]
    if kind is None:
        return (*own, *ours, *(_installed(name) for name in installed(ExtensionGroup.DATASETS)), ANY_IMAGES)
    for reader in (*own, *ours, ANY_IMAGES):
        if reader.kind == kind:
            return (reader,)
    check_kind(kind)
    return (_installed(kind),)


def check_kind(kind: str) -> None:
    """Refuse a kind that is none of ours and no entry point's."""
    check_name(ExtensionGroup.DATASETS, "dataset reader", kind, [reader.kind for reader in (*OURS, ANY_IMAGES)])


def _installed(name: str) -> Reader:
    return _made(name, load_extension(ExtensionGroup.DATASETS, name))


def _made(name: str, reader: object) -> Reader:
    return made(reader, Reader, f"dataset reader {name}")  # type: ignore[type-abstract]
