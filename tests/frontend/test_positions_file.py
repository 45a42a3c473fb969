"""Files of positions: degrees to metres against a closed form, columns by their names, broken lines by number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from maslam.frontend.errors import FrontendError
from maslam.frontend.files.geodesy import enu_of, geodetic_of
from maslam.frontend.files.positions import read_positions, write_positions


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


def test_a_published_example_comes_out_both_ways() -> None:
    """EPSG Guidance Note 7-2, method 9837 (WGS 84)."""
    origin = np.array([55.0, 5.0, 200.0])
    there = np.array([[53 + 48 / 60 + 33.82 / 3600, 2 + 7 / 60 + 46.38 / 3600, 73.0]])
    enu = np.array([[-189013.869, -128642.040, -4220.171]])
    np.testing.assert_allclose(enu_of(there, origin), enu, atol=0.02)
    off = np.abs(geodetic_of(enu, origin) - there)[0]
    assert off[:2].max() < 3e-7
    assert off[2] < 1e-3


def test_degrees_come_back_anywhere_on_earth() -> None:
    rng = np.random.default_rng(2)
    for lat in (-89.999, -33.0, 0.0, 48.0, 90.0):
        origin = np.array([lat, rng.uniform(-180, 180), 1000.0])
        enu = rng.uniform(-3000, 3000, (40, 3))
        back = geodetic_of(enu, origin)
        np.testing.assert_allclose(enu_of(back, origin), enu, atol=1e-6)


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


FIX = "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.status.status,field.status.service,"
FIX += "field.latitude,field.longitude,field.altitude,"
FIX += ",".join(f"field.position_covariance{k}" for k in range(9)) + ",field.position_covariance_type\n"


def test_messages_of_a_receiver_keep_their_own_times_and_covariances(tmp_path: Path) -> None:
    """As `rostopic echo -p` writes sensor_msgs/NavSatFix: the time of writing first, no fix as status -1 and nan."""
    path = tmp_path / "fix.csv"
    rows = [
        "1700000001900000000,1,1700000001500000000,gps,0,1,48.0,11.0,500.0,4,0,0,0,9,0,0,0,25,2",
        "1700000002900000000,2,1700000002500000000,gps,-1,1,nan,nan,nan,0,0,0,0,0,0,0,0,0,0",
        "1700000003900000000,3,1700000003500000000,gps,0,1,48.1,11.1,501.0,0,0,0,0,0,0,0,0,0,0",
    ]
    path.write_text(FIX + "\n".join(rows) + "\n")
    fixes = read_positions(path, sigma_m=7.0)
    assert fixes.stamps_ns.tolist() == [1_700_000_001_500_000_000, 1_700_000_003_500_000_000]
    assert fixes.geodetic is not None and fixes.geodetic.tolist() == [[48.0, 11.0, 500.0], [48.1, 11.1, 501.0]]
    np.testing.assert_allclose(fixes.sigma, [[2.0, 3.0, 5.0], [7.0, 7.0, 7.0]])  # the last one's is unknown
    assert fixes.notes == ("1 row without a fix left out",)


@pytest.mark.parametrize(
    ("head", "row", "sigma"),
    [
        ("sigma_east,sigma_north,sigma_up", "1,2,3", [1, 2, 3]),
        ("std_lon,std_lat,std_alt", "1,2,3", [1, 2, 3]),
        ("var_east,var_north,var_up", "1,4,9", [1, 2, 3]),
        ("cov_xx,cov_yy,cov_zz", "1,4,9", [1, 2, 3]),
        ("position_covariance[0],position_covariance[4],position_covariance[8]", "1,4,9", [1, 2, 3]),
        ("horizontal_accuracy,vertical_accuracy", "2,3", [2, 2, 3]),
        ("hAcc", "2", [2, 2, 4]),
        ("accuracy", "3", [3, 3, 3]),
        ("hdop", "1.5", [3, 3, 6]),
        ("speed", "1", [2, 2, 2]),
    ],
)
def test_noise_is_each_axis_own(head: str, row: str, sigma: list[float], tmp_path: Path) -> None:
    (tmp_path / "gps.csv").write_text(f"time,lat,lon,alt,{head}\n1,48,11,500,{row}\n")
    np.testing.assert_allclose(read_positions(tmp_path / "gps.csv").sigma, [sigma])


@pytest.mark.parametrize(
    ("head", "cells", "stamps_ns"),
    [
        ("header.stamp.sec,header.stamp.nanosec", ["17,5", "18,6"], [17_000_000_005, 18_000_000_006]),
        ("time [ms]", ["500", "1500"], [500_000_000, 1_500_000_000]),
        ("t_ns", ["500", "1500"], [500, 1500]),
        ("utc", ["2026-11-30T09:00:00.5Z", "2026-11-30T09:00:01.5Z"], [1_796_029_200_500_000_000, None]),
    ],
)
def test_times_are_those_that_the_heading_names(
    head: str, cells: list[str], stamps_ns: list[int | None], tmp_path: Path
) -> None:
    rows = "".join(f"{cell},1,2,3\n" for cell in cells)
    (tmp_path / "gps.csv").write_text(f"{head},east,north,up\n{rows}")
    for found, wanted in zip(read_positions(tmp_path / "gps.csv").stamps_ns.tolist(), stamps_ns, strict=True):
        assert wanted in (None, found)


def sentence(body: str) -> str:
    """With its checksum."""
    total = 0
    for letter in body.encode():
        total ^= letter
    return f"${body}*{total:02X}"


def test_sentences_of_a_receiver_become_fixes(tmp_path: Path) -> None:
    """The manual's own GGA example: 48 deg 07.038' N, 11 deg 31' E, 545.4 m above the sea, geoid 46.9 m up."""
    log = [
        sentence("GPRMC,235958.00,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W"),
        sentence("GPGGA,235958.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"),
        sentence("GPGGA,235959.00,4807.038,N,01131.000,E,0,00,,,M,,M,,"),
        sentence("GPGGA,235959.50,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,").replace("545.4", "999.4"),
        "2026/11/30 noise of a logger " + sentence("GPGGA,000000.25,0130.000,S,00115.000,W,4,12,1.0,10.0,M,-5.0,M,,"),
        sentence("GPGST,000001.00,1,,,,0.3,0.4,0.8"),
        sentence("GPGGA,000001.00,0130.000,S,00115.000,W,2,12,1.0,10.0,M,,M,,"),
        sentence("GPVTG,084.4,T,081.3,M,022.4,N,041.5,K"),
    ]
    path = tmp_path / "drive.nmea"
    path.write_text("\r\n".join(log) + "\r\n")
    fixes = read_positions(path, sigma_m=2.0)
    midnight = 764_467_200_000_000_000  # 24 March 1994, UTC
    assert (fixes.stamps_ns - midnight).tolist() == [-2_000_000_000, 250_000_000, 1_000_000_000]
    assert fixes.geodetic is not None
    place = [[48 + 7.038 / 60, 11 + 31 / 60, 592.3], [-1.5, -1.25, 5.0], [-1.5, -1.25, 10.0]]
    np.testing.assert_allclose(fixes.geodetic, place, atol=1e-9)
    np.testing.assert_allclose(fixes.sigma, [[1.8, 1.8, 3.6], [0.02, 0.02, 0.04], [0.4, 0.3, 0.8]])
    assert fixes.notes == ("1 GGA without a measured position left out", "1 sentence with a wrong checksum left out")


def test_sentences_without_a_date_count_from_midnight_and_say_so(tmp_path: Path) -> None:
    rows = ["235959.00,4807.038,N,01131.000,E,1,08,,1.0,M,,M,,", "000001.00,4807.038,N,01131.000,E,1,08,,1.0,M,,M,,"]
    (tmp_path / "gps.csv").write_text("".join(sentence(f"GNGGA,{row}") + "\n" for row in rows))
    fixes = read_positions(tmp_path / "gps.csv")
    assert fixes.stamps_ns.tolist() == [86_399_000_000_000, 86_401_000_000_000]
    assert any("no date" in note for note in fixes.notes)
    (tmp_path / "gps.csv").write_text(sentence("GNGGA,250000,x,N,01131.000,E,1,08,,1.0,M,,M,,") + "\n")
    with pytest.raises(FrontendError, match=r"gps\.csv:1: no GGA sentence"):
        read_positions(tmp_path / "gps.csv")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time,lat,latitude,lon\n1,2,3,4\n", ":1: columns lat and latitude both say lat"),
        ("time,lat,lon,var_e,var_n,var_u\n1,2,3,4,-1,1\n", ":2: a variance of -1 m2"),
        ("time,lat,lon\n1,2,nan\n", "no positions in this file"),
        ("time,lat,lon,sigma\n1,2,3,nan\n", ":2: not 4 numbers: sigma is 'nan'"),
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


@pytest.mark.parametrize("mark", [";", "\t"])
def test_decimal_commas_are_read_where_something_else_separates(mark: str, tmp_path: Path) -> None:
    path = tmp_path / "gps.csv"
    rows = ["time lat lon alt", "0,5 47,0008248 8,0017955 401,686", "1 47,0008334 -8,5 401,5"]
    path.write_text("".join(row.replace(" ", mark) + "\n" for row in rows))
    fixes = read_positions(path)
    assert fixes.stamps_ns.tolist() == [500_000_000, 1_000_000_000] and fixes.geodetic is not None
    assert fixes.geodetic.tolist() == [[47.0008248, 8.0017955, 401.686], [47.0008334, -8.5, 401.5]]


def test_semicolons_with_points_and_commas_alone_stay_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "gps.csv"
    for mark in (";", ","):
        path.write_text("time lat lon alt\n0.5 47 8 401\n".replace(" ", mark))
        geodetic = read_positions(path).geodetic
        assert geodetic is not None and geodetic.tolist() == [[47.0, 8.0, 401.0]]


def test_a_track_in_kml_is_refused_by_its_name_with_the_cure(tmp_path: Path) -> None:
    path = tmp_path / "track.kml"
    path.write_text("<?xml version='1.0'?>\n<kml><Placemark/></kml>\n")
    with pytest.raises(FrontendError, match=r"a KML file, which is not read; write .* table: .*lat lon alt"):
        read_positions(path)


def test_nanoseconds_in_a_column_of_their_own_count(tmp_path: Path) -> None:
    path = tmp_path / "gps.csv"
    path.write_text("sec,nsec,lat,lon,alt\n1700000000,250000000,48.0,9.0,400\n1700000001,5,48.1,9.0,400\n")
    assert read_positions(path, 1.0).stamps_ns.tolist() == [1_700_000_000_250_000_000, 1_700_000_001_000_000_005]
