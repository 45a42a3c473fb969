"""CPU time by part: each part's own, in each thread, and all that nobody accounts for besides."""

from __future__ import annotations

import threading

import pytest

from maslam.mas.live import cpu_parts as cpu_parts_module
from maslam.mas.live.cpu_parts import OTHER, CpuParts


class Clocks:
    """CPU clocks of a process with threads that the test moves on."""

    def __init__(self) -> None:
        self.threads: dict[int, float] = {}

    def work(self, seconds: float) -> None:
        me = threading.get_ident()
        self.threads[me] = self.threads.get(me, 7.0) + seconds

    def thread_time(self) -> float:
        return self.threads.get(threading.get_ident(), 7.0)

    def process_time(self) -> float:
        return 50.0 + sum(self.threads.values()) - 7.0 * len(self.threads)


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> Clocks:
    clocks = Clocks()
    monkeypatch.setattr(cpu_parts_module, "time", clocks)
    return clocks


def test_a_part_within_another_counts_for_itself_alone(clocks: Clocks) -> None:
    parts = CpuParts()
    clocks.work(3.0)
    with parts.part("outer"):
        clocks.work(1.0)
        with parts.part("inner"):
            clocks.work(10.0)
            with parts.part("outer"):
                clocks.work(0.25)
        clocks.work(0.5)
    with parts.part("inner"):
        clocks.work(2.0)
    assert parts.seconds() == {"inner": 12.0, "outer": 1.75, OTHER: 3.0}
    assert parts.began_s == 50.0


def test_parts_end_with_errors(clocks: Clocks) -> None:
    parts = CpuParts()

    def fail() -> None:
        with parts.part("outer"), parts.part("inner"):
            clocks.work(1.0)
            raise ValueError("a broken part")

    with pytest.raises(ValueError, match="broken"):
        fail()
    clocks.work(5.0)
    assert parts.seconds() == {"inner": 1.0, "outer": 0.0, OTHER: 5.0}


def test_threads_are_told_apart(clocks: Clocks) -> None:
    """A part that is open in one thread takes nothing of another's."""
    parts = CpuParts()

    def work() -> None:
        clocks.work(4.0)
        with parts.part("theirs"):
            clocks.work(1.5)

    with parts.part("mine"):
        clocks.work(1.0)
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
    assert parts.seconds() == {"mine": 1.0, "theirs": 1.5, OTHER: 4.0}
