"""One camera as OpenCV's calibration and ROS write it: a camera matrix and distortion coefficients. Also RTAB-Map's."""

from __future__ import annotations

from ..calibration import RawCamera, RawRig
from .checked_camera import camera, camera_matrix, refuse_other_names
from .fields import Fields

_MATRIX = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "camMatrix", "cam_matrix", "mtx", "K", "k")
_COEFFICIENTS = (
    "distortion_coefficients",
    "Distortion_Coefficients",
    "dist_coeffs",
    "distCoeffs",
    "dist_coeff",
    "dist_coefs",
    "distCoef",
    "distCoefs",
    "dist",
    "D",
    "d",
)
_SIZES = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
_RTABMAP_FISHEYE = 6  # RTAB-Map writes k1 k2 p1 p2 k3 k4 for a fisheye, with p1 = p2 = 0


def recognises(data: Fields) -> bool:
    """Whether these are the keys of this format."""
    return any(isinstance(data.data.get(key), list | dict) for key in _MATRIX)


def read(data: Fields) -> RawRig:
    """One camera; how a second one stands is in its file (:mod:`.opencv_pair`)."""
    return RawRig(read_one(data), no_pair=NO_PAIR)


NO_PAIR = "the file of one camera: a pair needs left.yaml and right.yaml (or baseline_m in our own form, or Stereo.b)"


def read_one(data: Fields) -> RawCamera:
    """The camera of one file, by the names of OpenCV, of ROS files, or of a ROS message."""
    refuse_other_names(data, "dist", (*_COEFFICIENTS, "distortion_model"))
    _refuse_part_of_image(data)
    coefficients_key = next((key for key in _COEFFICIENTS if key in data), None)
    coefficients = data.numbers(coefficients_key) if coefficients_key else ()
    size = next((data.size(*keys) for keys in _SIZES if keys[0] in data or keys[1] in data), None)
    model, coefficients = _model(data, coefficients)
    return camera(data, camera_matrix(data, data.first(*_MATRIX)), size, model, coefficients)


def _model(data: Fields, coefficients: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    """The model's name and its coefficients: OpenCV has a flag for its fisheye, and ``xi`` for its mirror."""
    if "xi" in data:
        xi = data.numbers("xi", 1)[0] if isinstance(data.data["xi"], list | dict) else data.number("xi")
        return "mei", (xi, *(coefficients or (0.0,) * 4))
    named = data.text(data.first("distortion_model", "camera_model"))
    if not data.says_fisheye:
        if named.lower() == "fisheye" and len(coefficients) == _RTABMAP_FISHEYE and not any(coefficients[2:4]):
            return named, (*coefficients[:2], *coefficients[4:])
        return named, coefficients
    if named.lower() not in ("", "fisheye", "equidistant"):
        raise data.fail("distortion_model", "with fisheye_model, fisheye")
    return "fisheye", coefficients


def _refuse_part_of_image(data: Fields) -> None:
    """A camera_info message may be of a part of the image, or of fewer pixels: then its numbers are not those of the
    images."""
    for key in ("binning_x", "binning_y"):
        if key in data and data.number(key) > 1:
            raise data.fail(key, "a calibration of the images as stored (0 or 1 here)")
    if isinstance(data.data.get("roi"), dict):
        roi, size = data.inner("roi"), data.size("width", "height") or (0, 0)
        for key, whole in zip(("x_offset", "y_offset", "width", "height"), (0, 0, *size), strict=True):
            if key in roi and roi.number(key) not in (0, whole):
                raise roi.fail(key, "a calibration of the whole image (0 here)")
