"""CPU time of a process by what it was spent on."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

OTHER = "other"
"""What no part accounts for: threads of libraries, mainly those of the network."""


class CpuParts:
    """``with parts.part("odometry"): …`` from any thread. A part within another one counts for itself alone.
    ``began_s``: CPU time of the process when this object was made."""

    def __init__(self) -> None:
        self.began_s = time.process_time()
        self._seconds: dict[str, float] = {}
        self._lock = threading.Lock()
        self._open = threading.local()

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """CPU time of this thread until the end of the block, but for parts inside, counts for ``name``."""
        outer: str | None = getattr(self._open, "name", None)
        self._mark(outer)
        self._open.name = name
        try:
            yield
        finally:
            self._mark(name)
            self._open.name = outer

    def seconds(self) -> dict[str, float]:
        """By part, seconds, since this object was made; they add up to the CPU time of the process."""
        with self._lock:
            parts = dict(sorted(self._seconds.items()))
        all_s = time.process_time() - self.began_s
        return {**parts, OTHER: max(all_s - sum(parts.values()), 0.0)}

    def _mark(self, name: str | None) -> None:
        """What this thread has used since the last mark was used for ``name``."""
        now_s = time.thread_time()
        if name is not None:
            with self._lock:
                self._seconds[name] = self._seconds.get(name, 0.0) + now_s - self._open.since_s
        self._open.since_s = now_s
