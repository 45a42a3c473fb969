"""The fast reader of plain tables, against Python's own reading of each number."""

import numpy as np
import pytest

from frontend.plain_numbers import plain_floats, plain_integers

NOT_PLAIN = [b"", b"\n\n", b"1 2\n3\n", b"1 2\n3 4 5", b"1 a\n", b"1,2\n", b"# 1\n", b"--1\n", b"1.2.3\n", b"1e\n",
             b"1e-\n", b"nan\n", b"inf\n", b".\n", b"-\n", b"1_0\n", b"12345678901234567890\n"]  # fmt: skip


def written(values):
    return "\n".join(map(repr, values.tolist())).encode()


def test_floats_come_back_to_the_last_bit():
    rng = np.random.default_rng(3)
    wide = rng.normal(size=20_000) * 10.0 ** rng.integers(-40, 40, 20_000)
    metres, rounded = rng.normal(0, 30, 20_000), np.round(rng.normal(0, 30, 20_000), 3)
    special = np.array([0.0, -0.0, 5e-324, 1.7976931348623157e308, 2.0**53, 0.1, -1e22, 1e23])
    values = np.concatenate([wide, metres, rounded, special])
    table = plain_floats(written(values))
    assert table.shape == (len(values), 1)
    assert table.tobytes() == values.tobytes()


def test_digits_that_no_float64_holds_are_rounded_as_python_rounds_them():
    rng = np.random.default_rng(4)
    digits, powers = rng.integers(2**53, 10**17, 20_000), rng.integers(6, 30, 20_000)
    texts = [f"{d}e-{p}" for d, p in zip(digits, powers, strict=True)]
    assert plain_floats("\n".join(texts).encode()).ravel().tolist() == [float(t) for t in texts]


def test_what_lies_in_the_middle_between_two_float64_is_left_to_others():
    """Half to even is a rule that the fast reader does not have."""
    for text in (b"9007199254740993", b"9007199254740995.0", b"4503599627370497.5"):
        assert plain_floats(b"1.5\n" + text) is None


def test_white_space_and_the_ways_to_write_a_number():
    assert plain_floats(b"  1.\t-.5\r\n\n3e2 4E+1").tolist() == [[1.0, -0.5], [300.0, 40.0]]
    assert plain_integers(b"1 2\r\n\n\t30  400\n").tolist() == [[1, 2], [30, 400]]
    assert plain_integers(b"999999999999999999").tolist() == [[999_999_999_999_999_999]]


@pytest.mark.parametrize("data", NOT_PLAIN)
def test_anything_else_is_not_plain(data):
    assert plain_floats(data) is None
    assert plain_integers(data) is None


@pytest.mark.parametrize("data", [b"1.0\n", b"1e0\n", b"-1\n"])
def test_whole_numbers_are_digits_alone(data):
    assert plain_integers(data) is None
