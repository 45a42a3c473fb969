"""Check of a focal length by the images: another one that explains them better."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from maslam.frontend.datasets import ImageSequence, Problem

    from ..common.progress import Progress

_OFF = 0.05
"""Share of the calibrated focal length by which the one of the images may differ."""


def check_focal(sequence: ImageSequence, progress: Progress | None) -> tuple[str, list[Problem]]:
    """The line of the report and what is wrong: the focal length estimated from the images against the one that is
    used, or why it cannot be known."""
    from maslam.frontend.datasets import Problem, Severity
    from maslam.frontend.datasets.focal_length import REFINE_STEPS, refine

    task = progress.start(f"focal length of {sequence.name}", REFINE_STEPS) if progress is not None else 0

    def advance(done: int) -> None:
        if progress is not None:
            progress.advance(task, done)

    found = refine(sequence, advance)
    advance(REFINE_STEPS)
    used = sequence.rig.camera.fx
    if found.focal_px is None:
        return f"is not known from the images: {found.why}", []
    off = found.focal_px / used - 1.0
    line = f"{found.focal_px:.1f} px by the images ({found.why}), {100 * off:+.1f} % of the one used"
    if abs(off) <= _OFF or sequence.focal_guess:
        return line, []
    message = (
        f"the focal length is {used:.1f} px by the calibration, but {found.focal_px:.1f} px by the images "
        f"({100 * off:+.1f} %): is the calibration of this camera and of this image size?"
    )
    return line, [Problem(Severity.WARNING, message)]
