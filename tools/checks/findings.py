"""What a sample of a sequence's images says about its calibration, its pairs, its depth and its light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from maslam.frontend.datasets import ImageSequence, Problem
    from maslam.frontend.frames import Frame

_SAMPLES = 8  # frames that are looked at
_SIDES_EVERY, _MOST_SIDES = 16, 32
"""Before a run a frame in so many, and so many in all, tells whether left and right images change places."""


@dataclass(frozen=True)
class ImageFindings:
    """A line on what the ``images`` show, a line for stereo (``rows``), a line for ``depth``, and what is wrong;
    ``off``: which of that says that the calibration of a pair is, else empty."""

    images: str = ""
    rows: str = ""
    depth: str = ""
    problems: tuple[Problem, ...] = ()
    off: str = ""


def samples_of(count: int, samples: int = _SAMPLES) -> list[int]:
    """Numbers of frames spread evenly over ``count``, the first and the last among them; none for fewer than two
    ``samples``."""
    return sorted({round(i * (count - 1) / (samples - 1)) for i in range(samples)}) if samples > 1 else []


def look_at(
    sequence: ImageSequence, frames: list[Frame], light: bool = True, more_sides: Sequence[int] = ()
) -> ImageFindings:
    """Findings of ``frames`` of the sequence, which are a sample of it; ``light``: also whether they are dark or have
    nothing to follow; ``more_sides``: frames that are read only to see whether left and right images change places."""
    from maslam.frontend.datasets import Severity
    from maslam.frontend.datasets.pair_check import fit_pair, match_pair
    from maslam.frontend.datasets.stored_image import folder_of

    from .depth_edges import edge_problems
    from .image_checks import check_image, image_lines
    from .pair_checks import pair_problems
    from .pair_sides import side_problems
    from .repeats import repeat_problems
    from .sensor_checks import check_depth, check_rows, depth_lines, turned_lines
    from .side_by_side import side_by_side_problems

    images, image_problems = image_lines([check_image(frame) for frame in frames]) if frames and light else ("", [])
    matches = [match_pair(frame.image, frame.right) for frame in frames if frame.right is not None]
    stereo = [frame for frame in frames if frame.right is not None]
    pairs = [one for pair in zip(stereo, matches, strict=True) if (one := check_rows(*pair)) is not None]
    depths = [check for frame in frames if (check := check_depth(frame)) is not None]
    rows, off = "", ""
    row_problems: list[Problem] = []
    if pairs:
        rows, off, row_problems = turned_lines(pairs, fit_pair(matches, sequence.rig.camera))
    problems = pair_problems(sequence, frames) or side_problems(sequence, stereo, matches, more_sides)
    problems = problems or side_by_side_problems(sequence, frames)
    if not any(problem.severity is Severity.ERROR for problem in problems):
        problems = [*problems, *row_problems]
    else:  # rows and sides of images that are no pairs say nothing of the calibration
        off = ""
    depth, depth_problems = depth_lines(depths) if depths else ("", [])
    if depths:
        problems = [*problems, *depth_problems, *edge_problems(frames, str(folder_of(sequence.depth[0])))]
    return ImageFindings(images, rows, depth, (*image_problems, *problems, *repeat_problems(sequence)), off)


def look_at_sample(sequence: ImageSequence) -> ImageFindings:
    """Findings of a sample of the sequence's images before they are tracked; those that cannot be read are passed over.
    Tracking itself counts the frames that are dark or have too few features."""
    from maslam.frontend.errors import FrontendError

    frames = []
    for i in samples_of(len(sequence)):
        try:
            frames.append(sequence.read(i))
        except FrontendError:
            continue
    sides = samples_of(len(sequence), min(_MOST_SIDES, len(sequence) // _SIDES_EVERY))
    return look_at(sequence, frames, light=False, more_sides=sides)
