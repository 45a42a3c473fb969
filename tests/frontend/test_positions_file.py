"""Files of positions: degrees to metres against a closed form, columns by their names, broken lines by number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from maslam.frontend.errors import FrontendError
from maslam.frontend.files.positions import enu_of, read_positions, write_positions


def test_degrees_become_metres_east_north_up() -> None:
    """On the equator a degree east is 111.32 km, north 110.574 km (WGS 84)."""
    origin = np.array([0.0, 10.0, 50.0])
    there = np.array([[0.0, 10.001, 50.0], [0.001, 10.0, 50.0], [0.0, 10.0, 57.0]])
    found = enu_of(there, origin)
    np.testing.assert_allclose(found[0], [111.320, 0.0, 0.0], atol=0.01)
    np.testing.assert_allclose(found[1], [0.0, 110.574, 0.0], atol=0.01)
    np.testing.assert_allclose(found[2], [0.0, 0.0, 7.0], atol=1e-6)
    north = np.array([60.0, 10.0, 0.0])  # there a degree of longitude is half as long, but for the flattening
    assert enu_of(np.array([[60.0, 10.001, 0.0]]), north)[0, 0] == pytest.approx(55.800, abs=0.01)


def test_columns_are_found_by_their_names(tmp_path: Path) -> None:
    path = tmp_path / "gps.csv"
    path.write_bytes(
        b"\xef\xbb\xbftimestamp,latitude,longitude,altitude,accuracy\r\n1700000000000000000,48.1,11.5,500,3\r\n"
    )
    fixes = read_positions(path)
    assert fixes.stamps_ns.tolist() == [1_700_000_000_000_000_000]
    assert fixes.geodetic is not None and fixes.geodetic.tolist() == [[48.1, 11.5, 500.0]]
    assert fixes.sigma.tolist() == [[3.0, 3.0, 3.0]]
    path.write_text("# time x y z\n1.5 1 2 3\n2.5 4 5 6\n")
    local = read_positions(path, sigma_m=0.5, antenna=np.array([0.1, 0.2, 0.3]), offset_s=10.0)
    assert local.stamps_ns.tolist() == [11_500_000_000, 12_500_000_000]
    assert local.enu.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert local.sigma[0].tolist() == [0.5] * 3
    write_positions(path, local)
    again = read_positions(path)
    for name in ("stamps_ns", "enu", "sigma", "antenna"):
        np.testing.assert_array_equal(getattr(again, name), getattr(local, name))
    path.write_text("1.0 7 8 9 0 0 0 1\n")
    assert read_positions(path).enu.tolist() == [[7, 8, 9]]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 2 3 4\n", ":1: no header"),
        ("time,east,north\n1,2\n", ":2: not 3 numbers"),
        ("time,east,north\n2,2,2\n1,2,2\n", ":3: time does not go on"),
        ("time,lat,lon\n1,95,2\n", ":2: latitude 95"),
        ("time,east,north,sigma\n1,2,3,0\n", ":2: a standard deviation of 0 m"),
        ("time,east,north\n", "no positions in this file"),
        ("time,speed\n1,2\n", "no positions: columns"),
    ],
)
def test_what_is_no_position_is_named(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "gps.csv").write_text(text)
    with pytest.raises(FrontendError, match=said):
        read_positions(tmp_path / "gps.csv")
