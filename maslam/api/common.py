"""What the functions of the face have in common: paths, settings, progress, one BLAS thread."""

from __future__ import annotations

import math
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from pydantic import BaseModel

from maslam.descriptors.choice import DescriptorLike
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.datasets.readers import ReaderLike
from maslam.frontend.datasets.reading_config import ReadingConfig
from maslam.frontend.recording_config import RecordingConfig
from maslam.tools.common.errors import EarlierResultError, ToolError
from maslam.tools.common.found_positions import PositionSettings
from maslam.tools.common.options import build
from maslam.tools.common.parallel import one_blas_thread
from maslam.tools.pipeline.positions import LONGEST_S
from maslam.tools.pipeline.preprocess_options import READING, RECORDING, SECTION, SECTIONS, PreprocessSettings

PathLike = str | Path
Settings = Mapping[str, object]
"""Settings by dotted name, ``{"places.threshold": 0.8}``, or as in a file, ``{"places": {"threshold": 0.8}}``."""
ProgressCallback = Callable[[str, int, int], None]
"""``callback(title, done, total)``: called now and then while something long goes on."""

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
Model = TypeVar("Model", bound=BaseModel)


def on_one_thread(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """``function`` with BLAS on one thread, as on the command line: the same files on every machine; errors name
    arguments, not options."""

    @wraps(function)
    def inside(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        with one_blas_thread():
            try:
                return function(*args, **kwargs)
            except EarlierResultError as error:
                raise error.in_python() from None

    return inside


def nested(settings: Settings | None) -> dict[str, Any]:
    """Settings as a file has them: a mapping for each section."""
    found: dict[str, Any] = {}
    for name, value in (settings or {}).items():
        *sections, last = name.split(".")
        inner = found
        for section in sections:
            inner = inner.setdefault(section, {})
            if not isinstance(inner, dict):
                raise ToolError(f"settings: '{name}' and '{name.rpartition('.')[0]}' cannot both be set")
        if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
            value = merged(inner.get(last), nested(value))
        inner[last] = value
    return found


def merged(base: Any, over: Mapping[str, Any]) -> dict[str, Any]:
    """``base`` with what ``over`` says instead, section by section."""
    values = dict(base) if isinstance(base, Mapping) else {}
    for name, value in over.items():
        values[name] = merged(values.get(name), value) if isinstance(value, Mapping) else value
    return values


def changed(base: Model, settings: Mapping[str, Any], origin: Path | None = None) -> Model:
    """``base`` with settings as a file has them; an unknown name or a value out of range is an error that names it."""
    return build(base, Namespace(), settings, origin)


def rig_kind(rig: RigKind | str | None) -> RigKind | None:
    """A rig by name."""
    try:
        return None if rig is None else RigKind(rig)
    except ValueError:
        raise ToolError(f"rig: {rig!r}: one of {', '.join(RigKind)} is meant") from None


def positions_of(
    gps: PathLike | None, offset_s: float, sigma_m: float, antenna_m: tuple[float, float, float] | None
) -> PositionSettings:
    """Settings of positions (GPS); numbers that make no sense are refused by the arguments' names."""
    if not (math.isfinite(sigma_m) and sigma_m > 0):
        raise ToolError(f"gps_sigma_m: metres above 0 are meant, not {sigma_m}")
    if not (math.isfinite(offset_s) and abs(offset_s) < LONGEST_S):
        raise ToolError(f"gps_offset_s: seconds are meant, not {offset_s}")
    if antenna_m is not None and (len(antenna_m) != 3 or not all(map(math.isfinite, antenna_m))):
        raise ToolError(f"gps_antenna_m: three numbers, metres, are meant, not {antenna_m}")
    return PositionSettings(None if gps is None else Path(gps), offset_s, sigma_m, antenna_m)


def check_least(name: str, value: int, least: int) -> None:
    """Refuse a count below ``least``."""
    if value < least:
        raise ToolError(f"{name}: at least {least}, not {value}")


def preprocess_settings(
    content: dict[str, Any],
    agents: int | None,
    overlap: int,
    rig: RigKind | str | None,
    dataset: str | None,
    readers: Sequence[ReaderLike],
    descriptor: DescriptorLike | str | Path,
    provider: str,
    vocabulary: PathLike | None,
    workers: int,
    overwrite: bool,
    positions: PositionSettings,
) -> PreprocessSettings:
    """Settings of preprocessing as the arguments of a function say them; ``content``: the sections of a file."""
    strange = sorted(set(content) - set(SECTIONS))
    if strange:
        known = " and ".join(f"'{name}.…'" for name in SECTIONS)
        raise ToolError(f"settings: unknown setting '{strange[0]}'; preprocessing knows {known}")
    check_least("overlap", overlap, 0)
    check_least("workers", workers, 1)
    kind = rig_kind(rig)
    return PreprocessSettings(
        odometry=changed(OdometryConfig(), content.get(SECTION, {})),
        recording=changed(RecordingConfig(), content.get(RECORDING, {})),
        agents=agents,
        overlap=overlap,
        rig=None if kind is None else kind.value,
        dataset=dataset,
        readers=tuple(readers),
        model=descriptor,
        provider=provider,
        vocabulary=None if vocabulary is None else Path(vocabulary),
        workers=workers,
        overwrite=overwrite,
        positions=positions,
        reading=changed(ReadingConfig(), content.get(READING, {})),
    )
