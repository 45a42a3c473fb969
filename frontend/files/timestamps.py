"""Time stamps: decimal seconds in files, exact integer nanoseconds inside."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from .text_tables import read_text

NS_PER_S = 1_000_000_000
_DECIMAL = re.compile(r"([+-]?)(\d+)(?:\.(\d*))?", re.ASCII)
_FLOAT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def stamp_ns_from_s(seconds: NDArray[np.float64] | float) -> NDArray[np.int64]:
    """Nearest integer nanoseconds to ``seconds``, of the same shape."""
    return np.rint(np.asarray(seconds, dtype=np.float64) * NS_PER_S).astype(np.int64)


def decimal_ns(text: str) -> int:
    """Seconds as written to nanoseconds, exactly: a float64 holds only 0.2 microseconds of a present-day Unix time.

    Digits beyond the ninth decimal are cut off. Raises ``ValueError`` for anything that is not a finite number, or more
    than 64 bits of nanoseconds (292 years).
    """
    found = _DECIMAL.fullmatch(text)
    if found:
        sign, whole, fraction = found.groups()
        magnitude = int(whole) * NS_PER_S + int(((fraction or "") + "0" * 9)[:9])
        return _bounded(-magnitude if sign == "-" else magnitude)
    if not _FLOAT.fullmatch(text):
        raise ValueError(f"not a finite number: {text!r}")
    seconds = float(text)
    return _bounded(round(seconds * NS_PER_S) if abs(seconds) < 2**63 else 2**63)


def integer_ns(text: str) -> int:
    """Nanoseconds as written. ``ValueError`` for anything that is not a whole number of at most 64 bits."""
    if not _DECIMAL.fullmatch(text) or "." in text:
        raise ValueError(f"not a whole number: {text!r}")
    return _bounded(int(text))


def _bounded(stamp_ns: int) -> int:
    if abs(stamp_ns) >= 2**63:
        raise ValueError("a time of more than 292 years")
    return stamp_ns


def seconds_text(stamp_ns: int) -> str:
    """Seconds with nine decimals: the inverse of :func:`decimal_ns`."""
    sign, magnitude = "-" if stamp_ns < 0 else "", abs(int(stamp_ns))
    return f"{sign}{magnitude // NS_PER_S}.{magnitude % NS_PER_S:09d}"


def span_text(stamps_ns: NDArray[np.int64]) -> str:
    """``from to`` in seconds with milliseconds, of at least one time."""
    return f"{stamps_ns[0] / NS_PER_S:.3f} to {stamps_ns[-1] / NS_PER_S:.3f} s"


def read_stamps(path: Path, nanoseconds: bool = False) -> NDArray[np.int64]:
    """Nanoseconds ``(N,)`` of the first column of a text file, which holds seconds, or integer ``nanoseconds``.

    Lines starting with ``#`` and empty ones are passed over; anything else that is not a time is an error with its
    line.
    """
    parse = integer_ns if nanoseconds else decimal_ns
    stamps = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        fields = line.replace(",", " ").split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            stamps.append(parse(fields[0]))
        except ValueError:
            unit = "nanoseconds" if nanoseconds else "seconds"
            raise FrontendError(f"{path}:{number}: not a time in {unit}: {line.strip()[:60]!r}") from None
    return np.array(stamps, dtype=np.int64)
