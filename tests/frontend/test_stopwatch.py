"""Time by stage: disjoint, complete, and from several threads."""

import threading
import time

import pytest

from maslam.frontend.stopwatch import Stopwatch, TimedStage


class Clock:
    """Time that moves only when told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.cpu_s = self.wall_s = 0.0
        monkeypatch.setattr(time, "thread_time", lambda: self.cpu_s)
        monkeypatch.setattr(time, "perf_counter", lambda: self.wall_s)

    def work(self, cpu_s: float, wall_s: float) -> None:
        self.cpu_s += cpu_s
        self.wall_s += wall_s


def test_a_stage_within_another_stops_the_outer_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, watch = Clock(monkeypatch), Stopwatch()
    with watch.stage(TimedStage.DETECT):
        clock.work(1.0, 2.0)
        with watch.stage(TimedStage.STEREO):
            clock.work(4.0, 8.0)
            with watch.stage(TimedStage.DECODE):
                clock.work(16.0, 32.0)
        clock.work(0.5, 0.5)
    times = watch.times
    assert list(times) == [TimedStage.DECODE, TimedStage.DETECT, TimedStage.STEREO]
    assert (times[TimedStage.DETECT].cpu_s, times[TimedStage.DETECT].wall_s) == (1.5, 2.5)
    assert (times[TimedStage.STEREO].cpu_s, times[TimedStage.STEREO].wall_s) == (4.0, 8.0)
    assert (times[TimedStage.DECODE].cpu_s, times[TimedStage.DECODE].wall_s) == (16.0, 32.0)
    assert sum(t.cpu_s for t in times.values()) == clock.cpu_s


def test_runs_add_up_also_those_that_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, watch = Clock(monkeypatch), Stopwatch()
    for _ in range(3):
        with watch.stage(TimedStage.TRACK):
            clock.work(1.0, 1.0)

    def fail() -> None:
        with watch.stage(TimedStage.TRACK):
            clock.work(1.0, 1.0)
            raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        fail()
    assert (watch.times[TimedStage.TRACK].cpu_s, watch.times[TimedStage.TRACK].count) == (4.0, 4)
    with watch.stage(TimedStage.CULL):
        clock.work(1.0, 1.0)
    assert watch.times[TimedStage.CULL].cpu_s == 1.0


def test_other_threads_add_theirs() -> None:
    watch = Stopwatch()
    threads = [
        threading.Thread(target=lambda: [watch.add(TimedStage.DECODE, 0.5, 1.0) for _ in range(200)]) for _ in "abcd"
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert watch.times[TimedStage.DECODE].count == 800
    assert watch.times[TimedStage.DECODE].cpu_s == 400.0
