"""Settings of ``maslam preprocess`` and their options, which ``maslam slam`` has too."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import UsageError
from ..common.found_positions import NO_POSITIONS, PositionSettings
from ..common.names import check_name
from ..common.options import add_model_options, build
from ..common.parser import add_ray, at_least_one
from .positions import add_position_options, positions_from

if TYPE_CHECKING:
    from maslam.descriptors.choice import DescriptorLike
    from maslam.frontend.config import OdometryConfig
    from maslam.frontend.datasets.readers import ReaderLike
    from maslam.frontend.datasets.reading_config import ReadingConfig
    from maslam.frontend.recording_config import RecordingConfig

SECTION = "odometry"
RECORDING = "recording"
READING = "images"
SECTIONS = (SECTION, RECORDING, READING)
"""Of a settings file, that are read here."""
DEFAULT_OVERLAP = 0  # key-frames: agents see no image of another's; the predecessor's split of KITTI takes 3


@dataclass(frozen=True)
class PreprocessSettings:
    """Settings of ``maslam preprocess``. ``agents`` None: one agent per sequence; ``overlap`` key-frames of a split
    sequence's neighbours; ``dataset``: the kind to read the source as; ``readers``: a user's own; ``store``: folder of
    the front end's results, by default OUT/frontend; ``recording``: what of the source is read, by default all;
    ``reading``: masks, and how images are understood, None: as they are; ``overwrite``: replace a result of another
    source or of other settings; ``ray``: address of a Ray cluster that does the front end's work, empty: as the
    environment says, None: this machine's processes do."""

    odometry: OdometryConfig
    agents: int | None = None
    overlap: int = DEFAULT_OVERLAP
    rig: str | None = None
    dataset: str | None = None
    readers: tuple[ReaderLike, ...] = ()
    model: DescriptorLike | str | Path = "default"
    provider: str = "CPU"
    vocabulary: Path | None = None
    workers: int = 0
    store: Path | None = None
    recording: RecordingConfig | None = None
    overwrite: bool = False
    positions: PositionSettings = NO_POSITIONS
    reading: ReadingConfig | None = None
    ray: str | None = None


def add_preprocess_arguments(parser: argparse.ArgumentParser) -> None:
    """The options shared with ``maslam slam``."""
    parser.add_argument(
        "--agents",
        type=at_least_one,
        metavar="N",
        help="cut one sequence into blocks for N agents (default: one agent a sequence)",
    )
    parser.add_argument(
        "--overlap",
        type=int,
        default=DEFAULT_OVERLAP,
        metavar="K",
        help="key-frames that a block takes from its neighbours, whose images both agents then have "
        f"(the thesis: 3; default: {DEFAULT_OVERLAP})",
    )
    parser.add_argument(
        "--rig", choices=["mono", "stereo", "rgbd"], help="use only this much of the sensors (default: all there is)"
    )
    parser.add_argument(
        "--dataset",
        metavar="KIND",
        help="read SRC as this kind: kitti, euroc, tum, 7scenes, tum-vi, kitti-raw, associations, replica, scannet, "
        "tartanair, film, bag, images, or an entry point of maslam.datasets (default: the first that recognises it)",
    )
    parser.add_argument(
        "--model",
        default="default",
        metavar="NAME|FILE",
        help="place descriptor: a shipped one, an ONNX file, or an entry point of maslam.descriptors "
        "(default: the shipped one)",
    )
    parser.add_argument(
        "--provider", default="CPU", metavar="NAME", help="where onnxruntime runs the place descriptor (default: CPU)"
    )
    parser.add_argument(
        "--vocabulary", type=Path, metavar="FILE", help="DBoW2 vocabulary of ORB words (default: the shipped one)"
    )
    parser.add_argument(
        "--workers",
        type=at_least_one,
        default=0,
        metavar="N",
        help="processes (default: one per core, at most one per sequence)",
    )
    add_ray(parser, "the front end's work")
    add_overwrite(parser)
    from maslam.frontend.config import OdometryConfig
    from maslam.frontend.datasets.reading_config import ReadingConfig
    from maslam.frontend.recording_config import RecordingConfig

    add_position_options(parser)
    add_model_options(parser, RecordingConfig(), RECORDING)
    add_model_options(parser, ReadingConfig(), READING)
    add_model_options(parser, OdometryConfig(), SECTION)


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """``--overwrite``."""
    parser.add_argument(
        "--overwrite", action="store_true", help="replace what OUT holds of another source or with other settings"
    )


def settings_from(arguments: argparse.Namespace, content: Mapping[str, Any]) -> PreprocessSettings:
    """The settings of one command line and the ``content`` of its ``--config`` file."""
    from maslam.frontend.config import OdometryConfig
    from maslam.frontend.datasets.reading_config import ReadingConfig
    from maslam.frontend.recording_config import RecordingConfig

    if arguments.overlap < 0:
        raise UsageError(f"--overlap {arguments.overlap}: a number of key-frames is meant")
    _check_names(arguments)
    return PreprocessSettings(
        odometry=build(OdometryConfig(), arguments, content.get(SECTION), arguments.config, SECTION),
        agents=arguments.agents,
        overlap=arguments.overlap,
        rig=arguments.rig,
        dataset=arguments.dataset,
        model=arguments.model,
        provider=arguments.provider,
        vocabulary=arguments.vocabulary,
        workers=arguments.workers,
        recording=build(RecordingConfig(), arguments, content.get(RECORDING), arguments.config, RECORDING),
        overwrite=arguments.overwrite,
        ray=arguments.ray,
        positions=positions_from(arguments),
        reading=build(ReadingConfig(), arguments, content.get(READING), arguments.config, READING),
    )


def _check_names(arguments: argparse.Namespace) -> None:
    """Refuse unknown names before any work."""
    from maslam.descriptors.choice import check_descriptor
    from maslam.descriptors.session import find_provider
    from maslam.frontend.datasets.readers import check_kind

    if arguments.dataset is not None:
        check_name("--dataset", check_kind, arguments.dataset)
    check_name("--model", check_descriptor, arguments.model)
    check_name("--provider", find_provider, arguments.provider)
