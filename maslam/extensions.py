"""Extensions that other packages offer by entry points: a policy, a dataset reader, a descriptor, a transport.

An entry point names an object, or a class or function without arguments that makes one::

    [project.entry-points."maslam.policies"]
    nearest = "my_package.policies:Nearest"
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from importlib.metadata import EntryPoint, entry_points
from types import FunctionType, MethodType
from typing import TypeVar

from ._suggestions import did_you_mean
from .errors import MaslamError

Kind = TypeVar("Kind")


class ExtensionGroup(StrEnum):
    """The groups of entry points that are read."""

    POLICIES = "maslam.policies"
    DATASETS = "maslam.datasets"
    DESCRIPTORS = "maslam.descriptors"
    TRANSPORTS = "maslam.transports"


def installed(group: ExtensionGroup) -> tuple[str, ...]:
    """Names of the installed extensions of a group, sorted; none of them is imported."""
    return tuple(sorted(_entry_points(group)))


def load_extension(group: ExtensionGroup, name: str) -> object:
    """What the entry point ``name`` stands for, not yet called. :class:`MaslamError` where there is none of this name,
    where two packages offer one, or where it cannot be imported."""
    found = _entry_points(group).get(name, [])
    if not found:
        raise MaslamError(f"there is no entry point '{name}' of {group}")
    if len(found) > 1:
        packages = " and ".join(sorted(_package(point) for point in found))
        raise MaslamError(f"{group}: both {packages} offer '{name}'")
    try:
        return found[0].load()
    except Exception as error:
        why = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise MaslamError(f"{group}: '{name}' of {_package(found[0])} cannot be imported: {why}") from error


def made(extension: object, base: type[Kind], name: str) -> Kind:
    """The object itself, or what a class or function without arguments makes; :class:`MaslamError` where that is not
    derived from ``base``."""
    made_one = extension if isinstance(extension, base) or not callable(extension) else extension()
    if not isinstance(made_one, base):
        raise MaslamError(f"{name}: a {type(made_one).__name__}, not derived from {base.__module__}.{base.__name__}")
    return made_one


def check_name(group: ExtensionGroup, what: str, name: str, ours: Iterable[str]) -> None:
    """Refuse a name that is none of ``ours`` and no entry point's: the nearest is named, or all there are."""
    known = sorted({*ours, *installed(group)})
    if name in known:
        return
    if ":" in name:  # as name_of has it
        raise MaslamError(
            f"{what} '{name}' was an object in Python: give it again, or make it an entry point of {group}"
        )
    raise MaslamError(f"there is no {what} '{name}'{did_you_mean(name, known)}")


def name_of(extension: object) -> str:
    """The name under which an object given in Python is noted: ``module:Class``, of a function ``module:function``."""
    named = extension if isinstance(extension, type | FunctionType | MethodType) else type(extension)
    return f"{named.__module__}:{named.__qualname__}"


def _entry_points(group: ExtensionGroup) -> dict[str, list[EntryPoint]]:
    found: dict[str, dict[str, EntryPoint]] = {}
    for point in entry_points(group=group.value):  # a package that stands on the path twice counts once
        found.setdefault(point.name, {})[f"{_package(point)} {point.value}"] = point
    return {name: list(points.values()) for name, points in found.items()}


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else point.value
