"""Options common to the actions of ``maslam netvlad``: rendered worlds, own sequences, and the message about torch."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from maslam._suggestions import did_you_mean

from ..common.errors import ToolError, UnknownName, UsageError
from ..common.parser import at_least_one

if TYPE_CHECKING:
    from ..place_benchmarks.revisits import RevisitSettings
    from .foreign_model import InputForm

CACHE = Path("worlds_cache")


def add_world_options(parser: argparse.ArgumentParser) -> None:
    """Options for the folder of rendered places and the processes that render them."""
    parser.add_argument(
        "--cache", type=Path, default=CACHE, metavar="DIR", help="rendered places, kept (default: %(default)s)"
    )
    parser.add_argument(
        "--workers", type=at_least_one, default=0, metavar="N", help="processes that render (default: one per core)"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")


def add_held_out_options(parser: argparse.ArgumentParser) -> None:
    """Options for the choice of held-out worlds."""
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
    from ..place_benchmarks.revisits import RevisitSettings

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
    from ..place_benchmarks.revisits import RevisitSettings

    return RevisitSettings(arguments.radius, arguments.angle, arguments.apart, arguments.spacing)


def add_input_options(parser: argparse.ArgumentParser) -> None:
    """What an ONNX file without a card is given (``InputForm``), in a group of their own."""
    bare = parser.add_argument_group("an ONNX file without a card")
    bare.add_argument("--input-pixels", type=int, metavar="N", help="resize images to about so many (default: 76800)")
    bare.add_argument("--input-size", metavar="WxH", help="resize to exactly this (default: what the file fixes)")
    bare.add_argument("--input-mean", metavar="LIST", help="grey levels taken off each channel (default: none)")
    bare.add_argument("--input-std", metavar="LIST", help="grey levels each channel is divided by (default: 1)")


def input_form_of(arguments: argparse.Namespace) -> InputForm:
    """What :func:`add_input_options` was given."""
    from ..worlds.command import size as parse_size
    from .foreign_model import InputForm

    size = None if arguments.input_size is None else parse_size(arguments.input_size, "--input-size")[::-1]
    mean, std = (_numbers(f"--input-{name}", getattr(arguments, f"input_{name}")) for name in ("mean", "std"))
    return InputForm(arguments.input_pixels, size, mean, std)


def _numbers(option: str, text: str | None) -> tuple[float, ...]:
    try:
        return tuple(float(word) for word in text.split(",")) if text else ()
    except ValueError:
        raise UsageError(f"{option} {text}: expected numbers with commas between them") from None


def kinds_of(arguments: argparse.Namespace) -> tuple[str, ...]:
    """``--kinds``, checked."""
    from .train import KINDS

    kinds = tuple(sorted(set(arguments.kinds.split(","))))
    for kind in kinds:
        if kind not in KINDS:
            raise UnknownName(f"--kinds {kind}: there is no such kind{did_you_mean(kind, KINDS)}")
    return kinds


class needing_torch:
    """Says which extra is missing where torch, kornia or onnx cannot be imported."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ModuleNotFoundError) and (error.name or "").split(".")[0] in {"torch", "kornia", "onnx"}:
            raise ToolError(f"{error.name} is not installed: pip install 'maslam[train]'") from error
