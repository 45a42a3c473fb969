"""What calibration files contradict, lack or hide: one line each, and nothing taken for something else."""

from __future__ import annotations

from pathlib import Path

import pytest
from calibration_texts import (
    ECHO,
    FISHEYE,
    K4,
    LOWER,
    MIDDLE,
    OPENCV,
    RADTAN,
    basalt,
    kalibr,
    kalibr_pair,
    nerfstudio,
    orb,
    read,
    stella,
    vins,
)

from maslam.frontend.cameras.calibration_files import read_calibration
from maslam.frontend.cameras.calibration_files.loading import load_fields
from maslam.frontend.errors import FrontendError

OWN = "width: 752\nheight: 480\nfx: 400\nfy: 401\ncx: 360\ncy: 240\n"
K_LINE = "camera_matrix: {data: [400, 0, 360, 0, 401, 240, 0, 0, 1]}\n"
REFUSED = [
    (stella("equirectangular", ""), "Camera.model: perspective or fisheye .* found 'equirectangular'"),
    (stella("radial_division", ""), "found 'radial_division'"),
    (stella("nonsense", ""), "found 'nonsense'"),
    (ECHO.format(model="nothing_known", d="[0, 0, 0, 0, 0]", **LOWER), "nothing_known"),
    (OWN + "baseline_m: nan\n", "baseline_m"),
    (stella("fisheye", FISHEYE.replace("Camera.k4: -0.001\n", "")), "Camera.k4: a number expected, found None"),
    (stella("perspective", "").replace("monocular", "panoramic"), "Camera.setup: monocular, stereo or RGBD expected"),
    (vins("SCARAMUZZA", MIDDLE, {}), "model_type: PINHOLE, KANNALA_BRANDT or MEI .* found 'SCARAMUZZA'"),
    (vins("MEI", {"gamma1": 1, "gamma2": 1, "u0": 1, "v0": 1}, RADTAN), "mirror_parameters: a group of keys expected"),
    (basalt("bal", {}), r"value0.intrinsics\[0\].camera_type: one of .* found 'bal'"),
    (basalt("ds", {"xi": 0.1}), r"value0.intrinsics\[0\].intrinsics.alpha: a number expected"),
    (basalt("ds", {"xi": 0.1, "alpha": 1.5}), "alpha 1.5 of double-sphere distortion is outside 0 to 1"),
    (basalt("eucm", {"alpha": 0.5, "beta": 0.0}), "beta 0 of extended-unified distortion is not above 0"),
    (nerfstudio(camera_model="EQUIRECTANGULAR"), "camera_model: OPENCV, .* found 'EQUIRECTANGULAR'"),
    (nerfstudio(camera_model="PINHOLE", k1=0.1), "coefficients for none distortion"),
    (nerfstudio(camera_model="OPENCV", k4=0.1), "k4: k1 k2 p1 p2 k3 for OPENCV"),
    ("cam0:\n" + kalibr("omni", [1, 400, 401, 360, 240], "equidistant", [0] * 4), "cam0.distortion_model: one of"),
    ("cam0:\n" + kalibr("ds", [400, 401, 360, 240], "none", []), "cam0.intrinsics: 6 finite numbers expected"),
    ("cam0:\n" + kalibr("ds", [0, 0.5, 4, 4, 3, 2], "none", [0.1]), "no coefficient of a distortion none expected"),
    ("cam0:\n  intrinsics: [400, 401, 360, 240]\n  distortion_type: 0\n  distortion: [0.1, 0.1, 0, 0, 0]\n",
     "cam0.distortion_type: no such key; did you mean 'distortion_model'"),
    ("cam0:\n  intrinsics: [400, 401, 360, 240]\n", "cam0.distortion_coeffs: a list of numbers expected"),
    (OWN.replace("fx: 400", "f: 400"), "f: no such key"),
    (kalibr_pair("", ""), "cam1.T_cn_cnm1: a list of numbers expected"),
    (orb("Camera").replace("KannalaBrandt8", "Omni"), "Camera.type: PinHole, KannalaBrandt8 or Rectified expected"),
    (orb("Camera").replace("KannalaBrandt8", "Rectified"), "coefficients for none distortion"),
    (orb("Camera").replace("Camera.k4: -0.001\n", ""), "Camera.k4: a number expected, found None"),
    (ECHO.format(model="plumb_bob", d="[0, 0, 0, 0, 0]", **LOWER).replace("binning_x: 0", "binning_x: 2"), "binning_x"),
    (ECHO.format(model="plumb_bob", d="[0]", **LOWER).replace("x_offset: 0", "x_offset: 40"), "roi.x_offset"),
    (ECHO.format(model="equidistant", d="[]", **LOWER), "0 coefficients for equidistant distortion"),
    (OPENCV.format(more="fisheye_model: 1\ndistortion_model: plumb_bob\n"), "with fisheye_model, fisheye expected"),
    (OPENCV.format(more="").replace("distortion_coefficients", "distortion_coefficents"),
     "distortion_coefficents: no such key; did you mean 'distortion_coefficients'"),
    (K_LINE.replace("400, 0, 360", "400, 3, 360"), "camera_matrix: a camera without skew"),
    (K_LINE.replace("400, 0, 360, 0, 401, 240, 0, 0, 1", "400, 0, 0, 0, 401, 0, 360, 240, 1"), "row by row"),
    (OWN + "k1: -0.28\nk2: 0.07\nbaseline: 0.54\n",
     "baseline: no such key; did you mean 'baseline_m'.*; k1, k2: no such key: .* use OpenCV's form"),
    (OWN + "rate_hz: -1\n", "rate_hz: a number above 0 expected"),
    (OWN + "depth_unit_m: 0\n", "depth_unit_m: a number above 0 expected"),
    (OWN.replace("752", "752.5"), "width: a whole number of pixels expected, found '752.5'"),
    (OWN.replace("width: 752\n", ""), "width: a number expected, found None"),
    (OWN.replace("fx: 400", "fx: 4_00"), "fx: a number expected, found '4_00'"),
    (OWN.replace("fx: 400", "fx: 4:00"), "fx: a number expected, found '4:00'"),
    (OWN + "fx: 410\n", "line 7: fx is there twice, with two values"),
    (OWN.replace(": ", ":"), "line 1: a blank is missing after the colon: 'width:752'"),
    ("%YAML:1.0\n---\nimage_width:320\nimage_height: 240\n" + K_LINE, "line 3: a blank is missing after the colon"),
    ("a: " + "[" * 5000, "nested too deeply"),
    ("a: &a [1, 1]\nb: &b [" + "*a, " * 30 + "]\n", "more than 20 references"),
    ("x" * 1_100_000, "1100000 characters: too large for a calibration"),
    ("? [1, 2]\n: 3\n", "a key is one word"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), REFUSED, ids=[f"{i}" for i in range(len(REFUSED))])
def test_what_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(FrontendError, match=message) as error:
        read(tmp_path, text)
    assert "\n" not in str(error.value) and str(error.value).startswith(str(tmp_path))


def test_tabs_between_words_are_blanks(tmp_path: Path) -> None:
    """OpenCV reads such settings; in front of a line they are refused, as YAML has it."""
    text = OWN.replace("fx: 400", "fx:\t400\t# pixels")
    assert read(tmp_path, text).left.fx == 400.0
    with pytest.raises(FrontendError, match="line 3"):
        read(tmp_path, OWN.replace("fx: 400", "\tfx: 400"))


def test_digits_are_decimal_ones(tmp_path: Path) -> None:
    """YAML 1.1 takes 0640 for an octal number."""
    assert read(tmp_path, OWN.replace("752", "0752")).left.size == (752, 480)
    assert read(tmp_path, "\ufeff" + OWN.replace("400", "4.0e+02")).left.fx == 400.0


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_byte_order_marks_and_line_ends_of_other_systems(tmp_path: Path, encoding: str) -> None:
    for ends in ("\n", "\r\n", "\r"):
        (tmp_path / "camera.yaml").write_bytes(OPENCV.format(more="").replace("\n", ends).encode(encoding))
        assert read_calibration(tmp_path / "camera.yaml").left.coefficients == K4
    (tmp_path / "transforms.json").write_bytes(nerfstudio(camera_model="PINHOLE").encode(encoding))
    assert read_calibration(tmp_path / "transforms.json").left.fx == 400.0


@pytest.mark.parametrize("word", ["north", "night.db3", "nan", "no", "Nora", "nullified", "~x"])
def test_words_that_begin_as_null_are_words(tmp_path, word):
    (tmp_path / "a.yaml").write_text(f"a: {word}\nb: [{word}, null, ~]\nc: null\nd:\n")
    found = load_fields(tmp_path / "a.yaml").data
    assert found == {"a": word, "b": [word, None, None], "c": None, "d": None}
