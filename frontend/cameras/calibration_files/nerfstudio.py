"""``transforms.json`` of nerfstudio and instant-ngp: the camera of its images."""

from __future__ import annotations

import numpy as np

from ...errors import FrontendError
from ..calibration import RawRig
from .checked_camera import camera, in_opencvs_order
from .fields import Fields

_HALF_PX = 0.5  # the centre of its first pixel is at (0.5, 0.5)
_FISHEYE, _RADIAL, _NONE = ("OPENCV_FISHEYE",), ("OPENCV", ""), ("PINHOLE", "SIMPLE_PINHOLE")
_FOCUSED = ("fl_x", "fl_y", "cx", "cy")
_FOCUS = 0.002  # share by which a phone's focus moves these from frame to frame: a pixel or two at the border
_KEYS = ("w", "h", "fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "camera_model")


def recognises(data: Fields) -> bool:
    """Whether these are the keys of this format."""
    frames = data.data.get("frames")
    first = frames[0] if isinstance(frames, list) and frames and isinstance(frames[0], dict) else {}
    named = any(key in data or key in first for key in ("fl_x", "camera_angle_x"))
    return named or (bool(first) and "camera_model" in data)


def read(data: Fields, stored_size: tuple[int, int] | None = None) -> RawRig:
    """The one camera of all images; frames with cameras of their own must all have the same. ``stored_size``
    ``(width, height)`` of the images: used where the file does not state one."""
    data = _common(data)
    model, size = data.text("camera_model").upper(), data.size("w", "h")
    if model not in (*_FISHEYE, *_RADIAL, *_NONE):
        raise data.fail("camera_model", "OPENCV, OPENCV_FISHEYE, PINHOLE or SIMPLE_PINHOLE (no other lens is read)")
    k = {key: data.number(key, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2")}
    fisheye = model in _FISHEYE or data.flag("is_fisheye")
    if fisheye:
        if k["p1"] or k["p2"]:
            raise data.fail("p1", "no tangential distortion of a fisheye (0 here)")
        coefficients: tuple[float, ...] = tuple(k[key] for key in ("k1", "k2", "k3", "k4"))
    elif k["k4"]:
        raise data.fail("k4", f"k1 k2 p1 p2 k3 for {model or 'OPENCV'} (no k4)")
    else:
        coefficients = in_opencvs_order(k)
    named = "fisheye" if fisheye else "none" if model in _NONE else "radtan"
    if named == "none":
        coefficients = coefficients if any(coefficients) else ()
    intrinsics = _intrinsics(data, size or stored_size)
    return RawRig(camera(data, intrinsics, size, named, coefficients), no_pair="the file of one camera")


def _intrinsics(data: Fields, size: tuple[int, int] | None) -> tuple[float, float, float, float]:
    if "fl_x" in data:
        fx = data.number("fl_x")
    elif size is not None:
        angle = data.number("camera_angle_x")
        if not 0.0 < angle < np.pi:
            raise data.fail("camera_angle_x", "an angle between 0 and pi, in radians,")
        fx = 0.5 * size[0] / float(np.tan(0.5 * angle))
    else:
        raise data.fail("fl_x", "a focal length in pixels (camera_angle_x needs w and h)")
    middle = (0.5 * size[0], 0.5 * size[1]) if size is not None else (None, None)
    cx, cy = data.number("cx", middle[0]), data.number("cy", middle[1])
    return fx, data.number("fl_y", fx), cx - _HALF_PX, cy - _HALF_PX


def _common(data: Fields) -> Fields:
    """The values of the file, with those of its frames: alike, or as little apart as a lens that focuses makes them;
    then the median of each."""
    frames = data.listed("frames") if "frames" in data else []
    own = [{key: frame.data[key] for key in _KEYS if key in frame} for frame in frames]
    if all(one == own[0] for one in own):
        return Fields({**data.data, **(own[0] if own else {})}, data.path)
    _refuse_unlike(data, frames)
    moving = [key for key in _FOCUSED if key in frames[0]]
    middle = {key: float(np.median([frame.number(key) for frame in frames])) for key in moving}
    return Fields({**data.data, **own[0], **middle}, data.path)


def _refuse_unlike(data: Fields, frames: list[Fields]) -> None:
    """One line that names two frames whose cameras are not one."""
    for key in _KEYS:
        if key in _FOCUSED and all(key in frame for frame in frames):
            values = [frame.number(key) for frame in frames]
            low, high = int(np.argmin(values)), int(np.argmax(values))
            alike = values[high] - values[low] <= _FOCUS * values[low]
        else:
            found = [frame.data.get(key) for frame in frames]
            low, high = 0, next((i for i, value in enumerate(found) if value != found[0]), 0)
            alike = high == 0
        if not alike:
            one, other = frames[low].data.get(key), frames[high].data.get(key)
            raise FrontendError(
                f"{data.path}: its frames are of several cameras: {key} is {one} in frames[{low}] "
                f"and {other} in frames[{high}]; one folder for each camera is needed"
            )


def focus_note(data: Fields) -> str:
    """What is said where the frames' cameras are not quite alike; empty where they are. For files that :func:`read`
    takes."""
    frames = data.listed("frames") if "frames" in data else []
    spread = 0.0
    for key in _FOCUSED:
        if frames and all(key in frame for frame in frames):
            values = np.array([frame.number(key) for frame in frames])
            spread = max(spread, float(values.max() / values.min() - 1.0))
    if not spread:
        return ""
    return f"each frame has a camera of its own, up to {100 * spread:.2g} % apart: the median is taken for all"
