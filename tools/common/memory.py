"""Memory of this process, as the operating system counts it."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

_STATUS, _STATM, _CLEAR = Path("/proc/self/status"), Path("/proc/self/statm"), Path("/proc/self/clear_refs")


def resident_mb() -> float:
    """Resident memory now, megabytes (10^6 bytes). Where the system does not tell, the peak so far, or NaN."""
    try:
        return int(_STATM.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except OSError:
        return peak_mb()


def peak_mb() -> float:
    """Highest resident memory since the start of the process, or since :func:`reset_peak`, megabytes.

    NaN where the system does not tell. ``getrusage`` only where there is nothing else: its peak starts with that of
    the parent process where the system forks to make a new one.
    """
    try:
        line = next(line for line in _STATUS.read_text(encoding="ascii").splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024 / 1e6
    except (OSError, StopIteration):
        if resource is None:
            return math.nan
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6


def reset_peak() -> None:
    """Count the peak from here on, where the system allows it."""
    try:
        _CLEAR.write_text("5", encoding="ascii")
    except OSError:
        return
