"""What the functions of the face have in common: paths, settings, progress, one BLAS thread."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from pydantic import BaseModel

from maslam.frontend.cameras.models import RigKind
from maslam.tools.common.errors import EarlierResultError, ToolError
from maslam.tools.common.options import build
from maslam.tools.common.parallel import one_blas_thread

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


def check_least(name: str, value: int, least: int) -> None:
    """Refuse a count below ``least``."""
    if value < least:
        raise ToolError(f"{name}: at least {least}, not {value}")
