"""Positions in other units than metres and degrees, and in GPX, are those same positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from maslam.frontend.errors import FrontendError
from maslam.frontend.files.positions import read_positions

PLACE = [48.1234567, 11.5000001, 512.25]
NOON_NS = 1_767_268_800_000_000_000  # 2026-01-01 12:00 UTC


def fixes_of(path: Path, text: str, **kept: float) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    path.write_text(text)
    fixes = read_positions(path, **kept)
    return fixes.enu if fixes.geodetic is None else fixes.geodetic, fixes.sigma, fixes.notes


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("time,latitudeE7,longitudeE7,altitude", "1,481234567,115000001,512.25"),
        ("time,lat_e7,lon_e7,alt_m", "1,481234567,115000001,512.25"),
        ("time,lat [1e7 deg],lon [1e7 deg],alt [mm]", "1,481234567,115000001,512250"),
        ("time,lat,lon,alt_mm", "1,48.1234567,11.5000001,512250"),
        ("time,lat_rad,lon_rad,alt (cm)", "1,0.83991276586,0.20071286572,51225"),
        ("time,lat,lon,alt_ft", "1,48.1234567,11.5000001,1680.6102362"),
    ],
)
def test_a_heading_names_the_unit(head: str, row: str, tmp_path: Path) -> None:
    place, _, notes = fixes_of(tmp_path / "gps.csv", f"{head}\n{row}\n")
    np.testing.assert_allclose(place, [PLACE], atol=1e-7)
    assert notes == ()


def test_metres_too(tmp_path: Path) -> None:
    text = "time,x [mm],y_mm,z (cm),sigma_x_mm,sigma_y [cm],sigma_z\n1,1000,2000,300,500,20,3\n"
    place, sigma, _ = fixes_of(tmp_path / "gps.csv", text)
    np.testing.assert_allclose(place, [[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(sigma, [[0.5, 0.2, 3.0]])
    _, sigma, _ = fixes_of(tmp_path / "gps.csv", "time,x,y,z,var_x[mm2],var_y[mm2],var_z[m2]\n1,1,2,3,4e6,1e6,9\n")
    np.testing.assert_allclose(sigma, [[2.0, 1.0, 3.0]])


def test_whole_numbers_of_a_flight_controller_are_told_by_their_size(tmp_path: Path) -> None:
    place, _, notes = fixes_of(tmp_path / "gps.csv", "timestamp,lat,lon,alt\n1,481234567,115000001,512250\n")
    np.testing.assert_allclose(place, [PLACE], atol=1e-7)
    assert len(notes) == 2 and "1e7" in notes[0] and "millimetres" in notes[1]
    place, _, notes = fixes_of(tmp_path / "gps.csv", "timestamp,lat,lon,alt\n1,481234567,115000001,512.25\n")
    np.testing.assert_allclose(place, [PLACE], atol=1e-7)
    assert len(notes) == 1
    place, _, notes = fixes_of(tmp_path / "gps.csv", "timestamp,lat,lon,alt\n1,48,11,512\n")
    assert place.tolist() == [[48.0, 11.0, 512.0]] and notes == ()
    with pytest.raises(FrontendError, match=r":2: latitude 4807"):
        fixes_of(tmp_path / "gps.csv", "timestamp,lat,lon,alt\n1,4807.5,1131.0,512\n")


def gpx(*points: str, head: str = '<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">') -> str:
    return (
        f"<?xml version='1.0' encoding='UTF-8'?>\n{head}\n<trk><trkseg>\n"
        + "\n".join(points)
        + "\n</trkseg></trk></gpx>"
    )


def point(second: float, lat: float = 48.0, more: str = "<ele>500</ele>") -> str:
    return f'<trkpt lat="{lat}" lon="11.5">{more}<time>2026-01-01T12:00:{second:04.1f}Z</time></trkpt>'


def test_a_track_of_a_phone_becomes_fixes_in_order_of_time(tmp_path: Path) -> None:
    rows = [
        point(2.0, 48.2, "<ele>502.5</ele><hdop>1.5</hdop>"),
        point(1.5, 48.1),
        point(1.5, 48.15),
        point(3.0, 48.3, "<ele>503</ele><fix>none</fix>"),
        '<trkpt lat="48.9" lon="11.5"><ele>1</ele></trkpt>',
        point(4.0, 48.4, "<extensions><x:speed xmlns:x='u'>3</x:speed></extensions><ele>504</ele>"),
        point(5.0, 48.5, ""),
    ]
    path = tmp_path / "gps.gpx"
    path.write_text(gpx(*rows))
    fixes = read_positions(path, sigma_m=3.0, offset_s=10.0)
    assert ((fixes.stamps_ns - NOON_NS) / 1e9).tolist() == [11.5, 12.0, 14.0]
    assert fixes.geodetic is not None
    assert fixes.geodetic.tolist() == [[48.1, 11.5, 500.0], [48.2, 11.5, 502.5], [48.4, 11.5, 504.0]]
    np.testing.assert_allclose(fixes.sigma, [[3, 3, 6], [4.5, 4.5, 9], [3, 3, 6]])
    assert fixes.notes == (
        "2 points without a time or a fix left out",
        "1 point without an elevation left out",
        "1 point with the time of another left out",
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (gpx('<trkpt lat="48" lon="11"/>'), "none of its 1 points has a time"),
        (gpx(), "no points in it"),
        (gpx(point(1.0, 95.0)), r":4: latitude 95"),
        (gpx(point(1.0).replace('lat="48.0"', "")), r":4: lat is no number: ''"),
        (gpx(point(1.0).replace("2026-01-01", "yesterday")), r":4: not a time: 'yesterday"),
        (gpx(point(1.0))[:-12], r": not GPX: "),
        (gpx(point(1.0)).replace("<gpx", '<!DOCTYPE gpx [<!ENTITY a "b">]><gpx', 1), "entities"),
    ],
)
def test_what_is_no_track_is_named(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "gps.gpx").write_text(text)
    with pytest.raises(FrontendError, match=said):
        read_positions(tmp_path / "gps.gpx")
