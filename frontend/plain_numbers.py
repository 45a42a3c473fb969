"""Tables of numbers without anything unusual in them, parsed in one pass over their bytes.

Plain: rows of the same length with white space between numbers, as in ``-12 1.5 1.5e-7``, each of at most 18 digits
after its leading zeros. Everything else is for a more patient reader.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_MOST = 10**17  # another digit on top of less than this still fits 63 bits
_MOST_DIGITS = 18
_LONGEST = 60  # characters of a number
_EXACT_POWERS = 22  # 10^22 is the largest power of ten that a float64 holds exactly
_POWERS = np.array([float(10**k) for k in range(_EXACT_POWERS + 1)])
_SPLITTER = 134217729.0  # 2^27 + 1
_TIE = 2.0**-96  # far above the error of a quotient of twice the digits, relative to it
_SPACE, _TAB, _NEWLINE, _RETURN = 32, 9, 10, 13
_MINUS, _PLUS, _POINT, _ZERO, _E, _SMALL_E = 45, 43, 46, 48, 69, 101
_NOT_PLAIN = -1


def plain_integers(data: bytes) -> NDArray[np.int64] | None:
    """The table ``(rows, columns)`` of numbers from 0, or None where it is not plain or empty."""
    out = np.empty(len(data) // 2 + 2, dtype=np.int64)
    count, width = _integers(np.frombuffer(data + b"\n", dtype=np.uint8), out)
    return out[:count].reshape(-1, width) if width else None


def plain_floats(data: bytes) -> NDArray[np.float64] | None:
    """The table ``(rows, columns)``, each number the float64 nearest to what is written; None where it is not plain or
    empty."""
    digits, decimals, late = _scanned(data)
    values, nearest = _quotients(digits, decimals)
    for at, start in late.tolist():
        values.flat[at] = float(data[start : start + _LONGEST].split(None, 1)[0])
    return values if nearest and values.size and np.isfinite(values).all() else None


def _scanned(data: bytes) -> tuple[NDArray[np.int64], NDArray[np.int16], NDArray[np.int64]]:
    """Each number's digits as one whole number ``(rows, columns)``, how many of them are decimals, and place and first
    byte ``(k, 2)`` of those that need more than a division."""
    most = len(data) // 2 + 1
    digits, decimals, late = np.empty(most, np.int64), np.empty(most, np.int16), np.empty((most, 2), np.int64)
    count, width, needed = _scan(np.frombuffer(data + b"\n", dtype=np.uint8), digits, decimals, late)
    shape = -1, max(width, 1)
    return digits[:count].reshape(shape), decimals[:count].reshape(shape), late[:needed]


def _quotients(digits: NDArray[np.int64], decimals: NDArray[np.int16]) -> tuple[NDArray[np.float64], bool]:
    """``digits / 10^decimals``, and whether all are certainly rounded to nearest: a quotient of twice the digits
    (Dekker 1971) tells, unless it is next to the middle between two float64."""
    power = _POWERS[decimals]
    high = digits.astype(np.float64)
    low = (digits - high.astype(np.int64)).astype(np.float64)
    first = high / power
    product, error = _product(first, power)
    second = (((high - product) - error) + low) / power
    total = first + second
    rest = np.abs(second - (total - first))
    gaps = [np.abs(np.nextafter(total, side) - total) for side in (-np.inf, np.inf)]
    near_middle = [np.abs(rest - 0.5 * gap) <= _TIE * np.abs(total) for gap in gaps]
    return total, not (near_middle[0] | near_middle[1])[digits != 0].any()


def _product(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The product and its rounding error, exactly."""
    a_high, b_high = _SPLITTER * a, _SPLITTER * b
    a_high -= a_high - a
    b_high -= b_high - b
    a_low, b_low = a - a_high, b - b_high
    product = a * b
    return product, a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)


@njit(cache=True, nogil=True)
def _blank(c):  # type: ignore[no-untyped-def]
    return c == _SPACE or _TAB <= c <= _RETURN


@njit(cache=True, nogil=True)
def _integers(text, out):  # type: ignore[no-untyped-def]
    """Number of numbers, and of columns: 0 where the table is not plain. The last byte is a line end.

    Without a branch for each digit and each blank: those of numbers of one, two or three digits cannot be foretold.
    """
    count = width = line = value = length = 0
    for c in text:
        digit = int(c) - _ZERO
        inside = 0 <= digit <= 9
        if (not inside and not _blank(c)) or length > _MOST_DIGITS:
            return 0, 0
        out[count] = value
        count += (length > 0) & (not inside)
        value = (10 * value + digit) * inside
        length = (length + 1) * inside
        if c == _NEWLINE and count > line:
            width = count if line == 0 else width
            if count - line != width:
                return 0, 0
            line = count
    return count, width


@njit(cache=True, nogil=True)
def _scan(text, digits, decimals, late):  # type: ignore[no-untyped-def]
    """Number of numbers, of columns, and of those in ``late``; all 0 where the table is not plain. The last byte is a
    line end."""
    count = width = line = needed = at = 0
    while at < len(text):
        if _blank(text[at]):
            if text[at] == _NEWLINE and count > line:
                width = count if line == 0 else width
                if count - line != width:
                    return 0, 0, 0
                line = count
            at += 1
            continue
        value, behind, end = _number(text, at)
        if end == _NOT_PLAIN:
            return 0, 0, 0
        if not 0 <= behind <= _EXACT_POWERS or (value == 0 and text[at] == _MINUS):
            late[needed] = count, at
            needed += 1
            value = behind = 0
        digits[count], decimals[count], at = value, behind, end
        count += 1
    return count, width, needed


@njit(cache=True, nogil=True)
def _number(text, start):  # type: ignore[no-untyped-def]
    """The number at ``start``: its digits, how many are decimals, and where it ends."""
    negative = text[start] == _MINUS
    first = start + negative
    value, at = _digits(text, first, 0)
    seen, decimals = at - first, 0
    if text[at] == _POINT:
        first = at + 1
        value, at = _digits(text, first, value)
        decimals = at - first
        seen += decimals
    if text[at] == _E or text[at] == _SMALL_E:
        down = text[at + 1] == _MINUS
        first = at + 2 if down or text[at + 1] == _PLUS else at + 1
        power, at = _digits(text, first, 0)
        seen = seen if at > first else 0
        decimals += power if down else -power
    if seen == 0 or at - start > _LONGEST or not _blank(text[at]):
        return 0, 0, _NOT_PLAIN
    return (-value if negative else value), decimals, at


@njit(cache=True, nogil=True)
def _digits(text, at, value):  # type: ignore[no-untyped-def]
    """``value`` with the digits at ``at`` behind it, as far as they fit, and where they end."""
    digit = int(text[at]) - _ZERO
    while 0 <= digit <= 9 and value < _MOST:
        value = 10 * value + digit
        at += 1
        digit = int(text[at]) - _ZERO
    return value, at
