"""Settings that are names of something outside their model: refused as a wrong choice is, with exit code 2."""

from __future__ import annotations

from collections.abc import Callable

from maslam.errors import MaslamError

from .errors import UnknownName


def check_name(place: str, check: Callable[[str], object], name: str) -> None:
    """Refuse a ``name`` that ``check`` refuses, with the ``place`` where it was given."""
    try:
        check(name)
    except MaslamError as error:
        raise UnknownName(f"{place}: {error}") from None
