"""Progress of long work on standard error: bars on a terminal, a line now and then in a log, silence on request."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol, TextIO

from .logs import ON_CONSOLE

LOG_EVERY_S = 15.0
log = logging.getLogger(__name__)


class Progress(Protocol):
    """Tasks that count up to a total; ``start`` gives the task's number for ``advance``."""

    def start(self, title: str, total: int) -> int:
        """A task of ``total`` steps begins; returns its number."""

    def advance(self, task: int, done: int) -> None:
        """``done`` of the task's total are ready (a level, not a step)."""

    def say(self, line: str) -> None:
        """One line that stays, above the bars."""


def _record(line: str) -> None:
    """Into the log file, if there is one."""
    level = logging.WARNING if line.startswith("warning: ") else logging.INFO
    if log.hasHandlers():  # without any, Python itself would print warnings, a second time
        log.log(level, "%s", line.removeprefix("warning: "), extra=ON_CONSOLE)


class Silent(Progress):
    """No progress; warnings still go to standard error."""

    def start(self, title: str, total: int) -> int:
        return 0

    def advance(self, task: int, done: int) -> None:
        return

    def say(self, line: str) -> None:
        print(line, file=sys.stderr)
        _record(line)


class CallbackProgress(Progress):
    """For Python: ``callback(title, done, total)`` is called at each step; lines that stay go to the log."""

    def __init__(self, callback: Callable[[str, int, int], None] | None = None) -> None:
        self._callback = callback
        self._tasks: list[tuple[str, int]] = []

    def start(self, title: str, total: int) -> int:
        self._tasks.append((title, total))
        return len(self._tasks) - 1

    def advance(self, task: int, done: int) -> None:
        if self._callback is not None:
            title, total = self._tasks[task]
            self._callback(title, done, total)

    def say(self, line: str) -> None:
        _record(line)


class LogProgress(Progress):
    """For a stream that is no terminal: one line when a task ends, and one each ``LOG_EVERY_S`` while it lasts."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._tasks: list[tuple[str, int]] = []
        self._shown_s: dict[int, float] = {}
        self._ended: set[int] = set()

    def start(self, title: str, total: int) -> int:
        self._tasks.append((title, total))
        self._shown_s[len(self._tasks) - 1] = time.monotonic()
        return len(self._tasks) - 1

    def advance(self, task: int, done: int) -> None:
        title, total = self._tasks[task]
        ended = done >= total and task not in self._ended
        if ended:
            self._ended.add(task)
        elif time.monotonic() - self._shown_s[task] < LOG_EVERY_S or task in self._ended:
            return
        self._shown_s[task] = time.monotonic()
        self._print(f"{title}: {done} of {total}")

    def say(self, line: str) -> None:
        self._print(line)
        _record(line)

    def _print(self, line: str) -> None:
        print(line, file=self._stream, flush=True)


class BarProgress(Progress):
    """Bars on a terminal, by rich."""

    def __init__(self, stream: TextIO) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        self._bars = Bars(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=Console(file=stream),
            transient=False,
        )
        self._bars.start()

    def start(self, title: str, total: int) -> int:
        return int(self._bars.add_task(title, total=total))

    def advance(self, task: int, done: int) -> None:
        self._bars.update(self._bars.task_ids[task], completed=done)

    def say(self, line: str) -> None:
        self._bars.console.print(line, markup=False, highlight=False)
        _record(line)

    def stop(self) -> None:
        """Leave the bars as they stand and give the terminal back."""
        self._bars.stop()


def counter(progress: Progress, title: str) -> Callable[[int, int], None]:
    """``progress`` as a function ``(done, total)``, for work that knows its total only when it begins."""
    tasks: list[int] = []

    def count(done: int, total: int) -> None:
        if not tasks:
            tasks.append(progress.start(title, total))
        progress.advance(tasks[0], done)

    return count


@contextmanager
def progress_on(stream: TextIO | None = None, quiet: bool = False) -> Iterator[Progress]:
    """The right kind of progress for ``stream`` (standard error), closed at the end whatever happens."""
    stream = sys.stderr if stream is None else stream
    if quiet:
        yield Silent()
    elif not stream.isatty():
        yield LogProgress(stream)
    else:
        bars = BarProgress(stream)
        try:
            yield bars
        finally:
            bars.stop()
