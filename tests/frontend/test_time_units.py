"""Times in any unit, as dates, and in the names of images: which unit is meant is told by size and rate."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from maslam.frontend.datasets.named_times import times_of_names
from maslam.frontend.files.time_units import NotATime, parse_times, unit_of_heading

START_NS = 1_700_000_000_123_456_789
FRAMES_NS = 33_333_333 * np.arange(30)


def written(stamps_ns: np.ndarray, unit_ns: int, digits: int) -> list[str]:
    """Whole and decimal digits of a time, by integers alone."""
    step = 10**digits
    scaled = [int(stamp) * step // unit_ns for stamp in stamps_ns]
    return [f"{one // step}.{one % step:0{digits}d}" if digits else str(one) for one in scaled]


@pytest.mark.parametrize("unit_ns", [10**9, 10**6, 10**3, 1])
@pytest.mark.parametrize("start_ns", [START_NS, 0, 123 * 10**9, 5_000 * 10**9])
def test_the_unit_of_a_camera_is_found(unit_ns: int, start_ns: int) -> None:
    """Unix times, and times since the start of a recording or of the machine."""
    stamps = start_ns + FRAMES_NS
    digits = {10**9: 9, 10**6: 6, 10**3: 3, 1: 0}[unit_ns]
    times = parse_times(written(stamps, unit_ns, digits))
    np.testing.assert_array_equal(times.stamps_ns, stamps)
    certain = unit_ns == 10**9 or start_ns == START_NS
    assert (times.doubt == "") == certain, "a unit that only the rate tells is said"


def test_as_floats_are_saved() -> None:
    times = parse_times([f"{float(stamp):.18e}" for stamp in START_NS + FRAMES_NS])
    assert np.abs(times.stamps_ns - START_NS - FRAMES_NS).max() <= 256  # what a float64 holds


@pytest.mark.parametrize(("step", "unit_ns", "words"), [
    (3, 10**9, "taken as seconds"), (50, 10**6, "taken as milliseconds"), (1, 10**9, "numbers of images?"),
])  # fmt: skip
def test_what_is_ambiguous_is_said(step: int, unit_ns: int, words: str) -> None:
    times = parse_times([str(i * step) for i in range(10)])
    np.testing.assert_array_equal(times.stamps_ns, np.arange(10) * step * unit_ns)
    assert words in times.doubt


def test_a_heading_decides() -> None:
    assert parse_times(["0", "3", "6"], unit_of_heading("t [ms]")).stamps_ns.tolist() == [0, 3_000_000, 6_000_000]
    for heading in ("#timestamp [ns]", "time_ns", "stamp(nsec)"):
        unit = unit_of_heading(heading)
        assert unit is not None and unit.ns == 1
    assert unit_of_heading("timestamp") is None


def test_dates() -> None:
    texts = ["2011-09-26 13:02:25.964389445", "2011-09-26 13:02:26.067"]
    start = round(datetime(2011, 9, 26, 13, 2, 25, tzinfo=UTC).timestamp()) * 10**9
    assert parse_times(texts).stamps_ns.tolist() == [start + 964389445, start + 1_067_000_000]
    assert parse_times(["2011-09-26T15:02:25+02:00"]).stamps_ns[0] == start


@pytest.mark.parametrize(
    "texts", [["0.1", "x"], ["0.1", "nan"], ["0.1", ""], ["0.1", "1e99"], ["1e12", "1e18", "1e25"]]
)
def test_what_is_no_time_is_named(texts: list[str]) -> None:
    with pytest.raises(NotATime) as error:
        parse_times(texts)
    assert error.value.index == len(texts) - 1


# ---- names


@pytest.mark.parametrize("form", [
    "{s}.{ns:09d}", "{s}_{ns:09d}", "cam0_{s}-{ns:09d}_rect", "{all}", "frame{all}", "{us}", "rgb_{ms}",
])  # fmt: skip
def test_times_in_names(form: str) -> None:
    stamps = START_NS // 10**6 * 10**6 + 50_000_000 * np.arange(20)
    names = [
        form.format(s=t // 10**9, ns=t % 10**9, all=t, us=t // 1000, ms=t // 10**6) for t in map(int, stamps.tolist())
    ]
    found = times_of_names(names)
    assert found is not None and found.doubt == ""
    np.testing.assert_array_equal(found.stamps_ns, stamps)


def test_dates_in_names() -> None:
    found = times_of_names(["IMG_20230405_123456.100", "IMG_20230405_123456.200"])
    assert found is not None and np.diff(found.stamps_ns).tolist() == [100_000_000]


def test_digits_trimmed_at_the_end_are_decimals() -> None:
    """As Python writes a float: 102.7 comes after 102.1013."""
    seconds = [1305031102 + round(0.1 * i + 0.0013 * (i % 7), 4) for i in range(40)]
    found = times_of_names([str(round(one, 4)) for one in seconds])
    assert found is not None and found.doubt == ""
    np.testing.assert_array_equal(found.stamps_ns, [round(one * 10**4) * 10**5 for one in seconds])


@pytest.mark.parametrize("mark", [".", "_"])
def test_nanoseconds_without_leading_zeros_are_told_and_named(mark: str) -> None:
    stamps = [1_700_000_000_000_000_000 + 33_000_000 * i for i in range(90)]
    found = times_of_names([f"{t // 10**9}{mark}{t % 10**9}" for t in stamps])
    assert found is not None and "without leading zeros (1700000000" in found.doubt
    np.testing.assert_array_equal(found.stamps_ns, stamps)


@pytest.mark.parametrize("names", [
    [f"{i:010d}" for i in range(9)],
    [f"{i:013d}" for i in range(9)],
    [f"{i:019d}" for i in range(9)],
    [f"frame_{i}" for i in range(9)],
    [f"cam0_{i:06d}" for i in range(9)],
    [f"{i}" for i in range(0, 900, 100)],
    ["2023-04-05", "2023-04-06"],
    [],
])  # fmt: skip
def test_numbers_of_images_are_no_times(names: list[str]) -> None:
    assert times_of_names(names) is None


def test_whole_numbers_in_steps_that_no_count_has_are_times() -> None:
    found = times_of_names([str(77_000_000_000 + 50_000_000 * i) for i in range(9)])
    assert found is not None and np.diff(found.stamps_ns).tolist() == [50_000_000] * 8 and "nanoseconds" in found.doubt
