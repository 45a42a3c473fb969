"""What the actions of ``maslam netvlad`` have in common: options for rendered worlds, and the word about torch."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from tools.errors import ToolError, UsageError

if TYPE_CHECKING:
    from tools.netvlad_posed import RevisitSettings

CACHE = Path("worlds_cache")


def add_world_options(parser: argparse.ArgumentParser) -> None:
    """Where rendered places are kept and who renders them."""
    parser.add_argument(
        "--cache", type=Path, default=CACHE, metavar="DIR", help="rendered places, kept (default: %(default)s)"
    )
    parser.add_argument(
        "--workers", type=int, default=0, metavar="N", help="processes that render (default: one a core)"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")


def add_held_out_options(parser: argparse.ArgumentParser) -> None:
    """Which held-out worlds."""
    parser.add_argument(
        "--worlds", type=int, default=2, metavar="N", help="held-out worlds of each kind (default: %(default)s)"
    )
    parser.add_argument(
        "--places", type=int, default=120, metavar="N", help="places of each world (default: %(default)s)"
    )
    parser.add_argument(
        "--kinds", default="indoor,town", metavar="KINDS", help="kinds of worlds (default: %(default)s)"
    )


def add_revisit_options(parser: argparse.ArgumentParser) -> None:
    """When two images of a user's own sequence show the same place (``RevisitSettings``), in a group of their own."""
    from tools.netvlad_posed import RevisitSettings

    settings = RevisitSettings()
    own = parser.add_argument_group("own sequences")
    for name, unit, default, what in (
        ("radius", "M", settings.radius_m, "metres within which two images show one place"),
        ("angle", "DEG", settings.angle_deg, "degrees within which they look the same way"),
        ("apart", "S", settings.apart_s, "seconds after which the same place is visited again"),
        ("spacing", "M", settings.spacing_m, "metres from one image taken to the next"),
    ):
        own.add_argument(f"--{name}", type=float, default=default, metavar=unit, help=f"{what} (default: %(default)g)")


def revisits_of(arguments: argparse.Namespace) -> RevisitSettings:
    """What :func:`add_revisit_options` was given."""
    from tools.netvlad_posed import RevisitSettings

    return RevisitSettings(arguments.radius, arguments.angle, arguments.apart, arguments.spacing)


def kinds_of(arguments: argparse.Namespace) -> tuple[str, ...]:
    """``--kinds``, checked."""
    from tools.netvlad_train import KINDS

    kinds = tuple(sorted(set(arguments.kinds.split(","))))
    if not set(kinds) <= set(KINDS):
        raise UsageError(f"--kinds {arguments.kinds}: {', '.join(KINDS)} are known")
    return kinds


class needing_torch:
    """Says which extra is missing where torch, kornia or onnx cannot be imported."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ModuleNotFoundError) and (error.name or "").split(".")[0] in {"torch", "kornia", "onnx"}:
            raise ToolError(f"{error.name} is not installed: pip install 'maslam[train]'") from error
