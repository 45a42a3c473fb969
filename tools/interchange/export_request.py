"""What an export is asked for, and what came of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from maslam.frontend.datasets.readers import ReaderLike

Program = Literal["colmap", "hloc", "nerfstudio", "gsplat", "evo", "mcap", "tf", "csv"]
Frames = Literal["keyframes", "all"]
Groups = Literal["largest", "all"]
RECONSTRUCTIONS: tuple[Program, ...] = ("colmap", "hloc", "nerfstudio", "gsplat")


@dataclass(frozen=True)
class ExportRequest:
    """``program``: for which; ``agent``: this one alone, None: all; ``frames``: images of key-frames, or of all placed
    frames; ``groups``: of agents that no match joins the largest, or each in a folder of its own; ``images``: where the
    source's folder is now; ``with_images``: of a recording."""

    program: Program
    agent: int | None = None
    frames: Frames = "keyframes"
    groups: Groups = "largest"
    images: Path | None = None
    with_images: bool = False
    overwrite: bool = False
    readers: Sequence[ReaderLike] = ()


@dataclass(frozen=True)
class Exported:
    """``folder``: what was written; ``lines``: about it, for people; ``record``: about it, for programs: the content of
    ``export.json``."""

    folder: Path
    lines: tuple[str, ...]
    record: dict[str, Any] = field(default_factory=dict)
