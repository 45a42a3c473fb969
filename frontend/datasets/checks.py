"""Plausibility checks of a data set's numbers; each message names file, number and unit."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..cameras.models import PinholeCamera, RigKind
from ..files.timestamps import NS_PER_S, seconds_text
from .base import Problems
from .images import not_there
from .numbering import MissingImages
from .stored_image import ImageRef, file_of

MAX_RATE_HZ = 1000.0
MIN_RATE_HZ = 0.01
USUAL_BASELINE_M = 0.01
MAX_BASELINE_M = 10.0
MIN_BASELINE_M = 0.001
_FEW = 2  # images of one camera, of which no third confirms what the others show
_SHOWN = 5  # gaps in numbers that are named
_GAP_FACTOR = 5.0  # times the median interval: a gap worth a warning
_FOCAL_RATIO = 1.05  # fx and fy farther apart: pixels are rarely so far from square
_SHORTEST_FOCAL = 0.1  # of the width: a pinhole of 157 degrees; a fisheye's of 180 degrees is 0.32
_SAME_SHAPE = 0.01  # of the ratio of width and height
_IN_CENTRE = 0.06  # of the width or height: nearly every principal point is nearer to the centre
_SLOW_HZ = 0.5  # a rate below is seldom a camera's that is followed from image to image
_CENTRE_SHARE = 0.25  # of the width or height: farther from the centre, it is probably of another image size

_TWICE = 0.5  # of the images: more under the name of another are no chance

SPLIT_CURE = (
    "cut each into its left half, in a folder image_0, and its right half, in image_1, with the calibration of the "
    "pair (ffmpeg -i IN -vf crop=iw/2:ih:0:0 image_0/%06d.png, and crop=iw/2:ih:iw/2:0 for image_1)"
)

STACKED_CURE = (
    "cut each into its upper half, in a folder image_0, and its lower half, in image_1, with the calibration of the "
    "pair (ffmpeg -i IN -vf crop=iw:ih/2:0:0 image_0/%06d.png, and crop=iw:ih/2:0:ih/2 for image_1; the other way "
    "round where the upper one is the right camera's)"
)


def check_count(images: int, kind: RigKind, folder: Path, problems: Problems) -> None:
    """Check that there are images to follow a camera of this kind through."""
    if images == 1:
        problems.error(f"{folder}: one image is too few; a camera is followed from image to image")
    elif images == _FEW and kind is RigKind.MONO:
        problems.warning(
            f"{folder}: {images} images: too few to track where these alone do not tell the motion of one camera"
        )


def check_kinds(names: Sequence[str], folder: Path, problems: Problems) -> None:
    """Check that images do not stand twice in a folder, under the same names in two formats."""
    suffixes = Counter(os.path.splitext(name)[1] for name in names)
    if len(suffixes) < 2:
        return
    twice = [stem for stem, count in Counter(os.path.splitext(name)[0] for name in names).items() if count > 1]
    if len(twice) > _TWICE * len(names) / 2:
        kinds = " and ".join(sorted(suffixes))
        problems.error(
            f"{folder}: {len(twice)} of its {len(names)} images have the name of another ({twice[0]}), as {kinds}: the "
            "same images in two formats? move one of them away"
        )


def check_numbers(missing: Sequence[MissingImages], folder: Path, problems: Problems) -> None:
    """Name the images that the numbers in the file names lack."""
    if missing:
        count = sum(one.count for one in missing)
        shown = ", ".join(str(one) for one in missing[:_SHOWN])
        problems.warning(
            f"{folder}: {count} image{'s' if count > 1 else ''} missing by the numbers in the file names: "
            f"{shown}{_more(len(missing) - _SHOWN)}; time goes on meanwhile"
        )


def check_stamps(stamps_ns: NDArray[np.int64], names: Sequence[str], source: Path, problems: Problems) -> None:
    """Check that ``stamps_ns`` ``(N,)`` ascend, at a rate that a camera has; ``names`` names each frame in messages."""
    intervals = np.diff(stamps_ns)
    if not len(intervals):
        return
    for i in np.flatnonzero(intervals <= 0)[:1]:
        how = "goes back" if intervals[i] < 0 else "stands still"
        reverse = "; all are in reverse: list each image's name beside its time" if (intervals < 0).all() else ""
        problems.error(
            f"{source}: time {how} at frame {i + 1} ({names[i + 1]}): "
            f"{seconds_text(stamps_ns[i])} s, then {seconds_text(stamps_ns[i + 1])} s"
            + _more(int((intervals <= 0).sum()) - 1)
            + (reverse if len(intervals) > 1 else "")
        )
        return
    median_s = float(np.median(intervals)) / NS_PER_S
    if not MIN_RATE_HZ <= 1.0 / median_s <= MAX_RATE_HZ:
        problems.error(
            f"{source}: {1.0 / median_s:.4g} images per second (one every {median_s:.4g} s), outside "
            f"{MIN_RATE_HZ} to {MAX_RATE_HZ:.0f}: time stamps are in another unit than expected"
        )
    elif 1.0 / median_s < _SLOW_HZ:
        problems.warning(
            f"{source}: {1.0 / median_s:.4g} images per second (one every {median_s:.4g} s): is that the rate of these "
            "images? speeds and gaps are judged by it"
        )
    gaps = np.flatnonzero(intervals > _GAP_FACTOR * median_s * NS_PER_S)
    if len(gaps):
        problems.warning(
            f"{source}: a gap of {intervals[gaps[0]] / NS_PER_S:.3f} s after {names[gaps[0]]}{_more(len(gaps) - 1)}; "
            f"the median interval is {median_s:.4g} s"
        )


def check_camera(camera: PinholeCamera, source: Path, problems: Problems) -> None:
    """Check for finite positive focal lengths, close to each other, and a principal point inside the image, near its
    centre."""
    values = (camera.fx, camera.fy, camera.cx, camera.cy)
    if not np.isfinite(values).all() or min(camera.fx, camera.fy) <= 0:
        problems.error(
            f"{source}: focal lengths {camera.fx}, {camera.fy} px and principal point "
            f"{camera.cx}, {camera.cy} px cannot be"
        )
        return
    if camera.fx < _SHORTEST_FOCAL * camera.width:
        problems.error(
            f"{source}: a focal length of {camera.fx:.4g} px for an image {camera.width} px wide is that of no camera: "
            "in millimetres, or relative to the width? pixels are meant"
        )
    ratio = max(camera.fx, camera.fy) / min(camera.fx, camera.fy)
    if ratio > _FOCAL_RATIO:
        problems.warning(
            f"{source}: fx {camera.fx:.2f} px and fy {camera.fy:.2f} px differ by {100 * (ratio - 1):.0f} %: "
            "pixels are seldom so far from square"
        )
    if not (0 <= camera.cx < camera.width and 0 <= camera.cy < camera.height):
        problems.error(
            f"{source}: the principal point ({camera.cx:.1f}, {camera.cy:.1f}) px lies outside the image of "
            f"{camera.width}x{camera.height}: the calibration is for another image size"
        )
    elif _exchanged(camera):
        problems.warning(
            f"{source}: the principal point (cx {camera.cx:.1f}, cy {camera.cy:.1f}) px of an image of "
            f"{camera.width}x{camera.height} would be in its centre the other way round: are cx and cy exchanged?"
        )
    elif abs(camera.cx / camera.width - 0.5) > _CENTRE_SHARE or abs(camera.cy / camera.height - 0.5) > _CENTRE_SHARE:
        problems.warning(
            f"{source}: the principal point ({camera.cx:.1f}, {camera.cy:.1f}) px is far from the centre of the image "
            f"of {camera.width}x{camera.height}: is the calibration for another image size?"
        )


def _exchanged(camera: PinholeCamera) -> bool:
    """Whether cx and cy in each other's place would be near the centre, and are not as they stand."""

    def off(cx: float, cy: float) -> float:
        return max(abs(cx / camera.width - 0.5), abs(cy / camera.height - 0.5))

    return off(camera.cy, camera.cx) < _IN_CENTRE and off(camera.cx, camera.cy) > 2.0 * _IN_CENTRE


def check_size(
    calibrated: tuple[int, int] | None, stored: tuple[int, int], source: Path, image: ImageRef, problems: Problems
) -> None:
    """Compare the size that the calibration was made for with that of the first image; both ``(width, height)``,
    pixels."""
    if calibrated is None or calibrated == stored:
        return
    made_for, found = (f"{width}x{height}" for width, height in (calibrated, stored))
    line = f"{source}: a calibration for {made_for} pixels, but {image} has {found}"
    if calibrated == stored[::-1]:
        line += ": turned by 90 degrees"
    elif stored == (2 * calibrated[0], calibrated[1]):
        line += f": two pictures side by side? {SPLIT_CURE}"
    elif stored == (calibrated[0], 2 * calibrated[1]):
        line += f": two pictures one above the other? {STACKED_CURE}"
    elif abs(calibrated[0] * stored[1] / (calibrated[1] * stored[0]) - 1.0) < _SAME_SHAPE:
        line += f": images scaled by {stored[0] / calibrated[0]:.4g} after calibration need their own calibration"
    problems.error(line)


def check_side_by_side(T_left_right: NDArray[np.float64], source: Path, problems: Problems) -> bool:
    """Check that the cameras of a pair stand beside each other; ``T_left_right`` ``(4, 4)`` metres."""
    x, y, z = T_left_right[:3, 3].tolist()
    if not np.isfinite([x, y, z]).all() or abs(x) >= max(abs(y), abs(z)):
        return True
    apart, where = (y, "below" if y > 0 else "above") if abs(y) >= abs(z) else (z, "before" if z > 0 else "behind")
    cure = "; turn both images by 90 degrees, and calibrate them so" if abs(y) >= abs(z) else ""
    problems.error(
        f"{source}: the right camera stands {abs(apart):.4g} m {where} the left one, {abs(x):.4g} m beside it: pairs "
        f"are read only where the cameras stand side by side{cure}"
    )
    return False


def check_baseline(baseline_m: float, source: Path, problems: Problems) -> None:
    """Check that the baseline, metres, is positive and of a size that a rig has."""
    if not np.isfinite(baseline_m) or baseline_m == 0:
        problems.error(f"{source}: the stereo baseline is {baseline_m} m")
    elif baseline_m < 0:
        problems.error(
            f"{source}: the stereo baseline is {baseline_m:.4g} m: the right camera stands left of the left one; "
            "are the two swapped?"
        )
    elif not MIN_BASELINE_M <= baseline_m <= MAX_BASELINE_M:
        problems.error(
            f"{source}: the stereo baseline is {baseline_m:.4g} m, outside {MIN_BASELINE_M} to {MAX_BASELINE_M:.0f} m: "
            "another unit than metres?"
        )
    elif baseline_m < USUAL_BASELINE_M:
        problems.warning(
            f"{source}: the stereo baseline is {1000.0 * baseline_m:.3g} mm, as endoscopes have: is it in metres? "
            "(ORB-SLAM's Camera.bf is the baseline times fx)"
        )


def check_files(images: Sequence[ImageRef], what: str, problems: Problems) -> None:
    """Check that the files of all ``images`` exist, and that none comes twice."""
    missing = not_there(list(dict.fromkeys(map(file_of, images))))
    if missing:
        problems.error(f"{missing[0]}: the {what} is missing{_more(len(missing) - 1)}")
    listed = Counter(image for image in images if isinstance(image, Path))
    if len(listed) < listed.total():
        twice = next(path for path, count in listed.items() if count > 1)
        more = listed.total() - len(listed)
        problems.warning(f"{twice}: {more} of {len(images)} {what}s are files that come a second time")


def _more(count: int) -> str:
    return f" (and {count} more)" if count > 0 else ""
