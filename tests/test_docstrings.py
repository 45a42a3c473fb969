"""Whoever may be imported says what it is: each public module, class, function, method and property."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from functools import cached_property
from types import ModuleType

import pytest

ROOMS = ("maslam.api", "maslam.backend", "maslam.descriptors", "maslam.frontend", "maslam.mas", "maslam.tools")


def modules() -> list[str]:
    """All modules of the rooms."""
    found = []
    for room in ROOMS:
        path = importlib.import_module(room).__path__
        found += [room, *(one.name for one in pkgutil.walk_packages(path, f"{room}."))]
    return found


def undocumented(module: ModuleType) -> Iterator[str]:
    """Public names of a module that have no docstring; an overriding method may have its base's."""
    if not inspect.getdoc(module):
        yield module.__name__
    for name, thing in sorted(vars(module).items()):
        if name.startswith("_") or getattr(thing, "__module__", None) != module.__name__:
            continue
        if inspect.isfunction(thing) and not inspect.getdoc(thing):
            yield name
        if inspect.isclass(thing):
            own = thing.__dict__.get("__doc__") or ""
            if not own or own.startswith(f"{name}("):  # which dataclass makes up
                yield name
            yield from (f"{name}.{member}" for member in members(thing) if not inspect.getdoc(getattr(thing, member)))


def members(kind: type) -> list[str]:
    """Methods and properties that a class defines itself."""
    code = (property, cached_property, classmethod, staticmethod)
    return [
        n for n, v in vars(kind).items() if not n.startswith("_") and (inspect.isfunction(v) or isinstance(v, code))
    ]


class Base:
    """Of the next test."""

    def said(self) -> None:
        """Once, here."""


class Bare(Base):
    def said(self) -> None: ...

    @property
    def silent(self) -> int:
        return 1


def test_the_rule_sees_what_is_missing() -> None:
    here = ModuleType("here", "A module.")
    for thing in (Base, Bare):
        vars(here)[thing.__name__] = type(thing.__name__, thing.__bases__, {**vars(thing), "__module__": "here"})
    assert list(undocumented(here)) == ["Bare", "Bare.silent"]


@pytest.mark.parametrize("room", ROOMS)
def test_everything_public_is_documented(room: str) -> None:
    missing = []
    for name in modules():
        if name.startswith(room):
            try:
                module = importlib.import_module(name)
            except ImportError as error:  # an extra that is not installed
                if str(error.name).startswith("maslam"):
                    raise
                continue
            missing += [f"{name}: {one}" for one in undocumented(module)]
    assert missing == []
