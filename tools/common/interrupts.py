"""Ctrl-C and SIGTERM at any moment: one line, nothing half-written, and an exit code that says which."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from types import FrameType
from typing import Any

from maslam._temporary import delete_kept_folders

_AGAIN_S = 1.0
_IMPATIENT = 3
INTERRUPTED, TERMINATED = 130, 143


class Terminated(KeyboardInterrupt):
    """Somebody wants this process to end (SIGTERM, SIGHUP): the same as Ctrl-C, but for its exit code."""


class Interrupts:
    """Within :func:`interrupts`: ``seen`` is what came, None as long as nothing did.

    Compiled code that calls Python loses an exception that is raised there, and some libraries put one of their own in
    its place. So the exception is raised again each second until it arrives; and whoever catches another one looks at
    ``seen``.
    """

    def __init__(self) -> None:
        self.seen: type[KeyboardInterrupt] | None = None
        self._times = 0
        self._arrived = False
        self._put_off = 0

    @contextmanager
    def put_off(self) -> Iterator[None]:
        """What comes within the block is raised at its end: in the middle, a process would be half started."""
        self._put_off += 1
        try:
            yield
        finally:
            self._put_off -= 1
        if self.seen is not None and not self._arrived and not self._put_off:
            _repeat(_AGAIN_S)
            raise self.seen

    def arrived(self) -> None:
        """The exception has reached the end of the work: do not raise it again."""
        self._arrived = True
        _repeat(0.0)

    def came(self, number: int, _: FrameType | None) -> None:
        """Handler of the signals."""
        self.seen = KeyboardInterrupt if number == signal.SIGINT else Terminated
        self._times += 1
        if self._put_off:
            return
        if self._arrived or (self._times < _IMPATIENT and _on_its_way(sys.exc_info()[1])):
            return  # work is being undone
        _repeat(_AGAIN_S)
        raise self.seen

    def again(self, _number: int, _: FrameType | None) -> None:
        """Handler of the alarm. Work that is being undone because of the exception is left in peace."""
        if self.seen is not None and not self._arrived and not self._put_off and not _on_its_way(sys.exc_info()[1]):
            raise self.seen


_current: Interrupts | None = None
"""Of the main thread, within :func:`interrupts`."""


def _on_its_way(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__context__
    return False


def _silent_where_lost(lost: Any) -> None:
    """Python shows exceptions that nobody can catch; this one is raised again."""
    if not (lost.exc_type is not None and issubclass(lost.exc_type, KeyboardInterrupt)):
        sys.__unraisablehook__(lost)


def _repeat(seconds: float) -> None:
    if hasattr(signal, "setitimer"):  # not on Windows
        signal.setitimer(signal.ITIMER_REAL, seconds, seconds)


@contextmanager
def interrupts() -> Iterator[Interrupts]:
    """Within the block, SIGINT raises ``KeyboardInterrupt``, SIGTERM and SIGHUP :class:`Terminated`. Only in the main
    thread, which alone is sent signals; elsewhere nothing changes."""
    global _current
    one = Interrupts()
    if threading.current_thread() is not threading.main_thread():
        yield one
        return
    wanted: dict[str, Any] = {"SIGINT": one.came, "SIGTERM": one.came, "SIGHUP": one.came, "SIGALRM": one.again}
    before: dict[int, Any] = {}
    for name, handler in wanted.items():
        number = getattr(signal, name, None)  # Windows lacks some
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:  # nohup, a shell's background job
            before[number] = signal.signal(number, handler)
    hook, sys.unraisablehook = sys.unraisablehook, _silent_where_lost
    outer, _current = _current, one
    try:
        yield one
    finally:
        _current = outer
        _repeat(0.0)
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def held_back() -> Iterator[None]:
    """Signals reach this process only after the block. Those of the terminal do not reach a process that is started in
    it either, which inherits that: :func:`let_through` ends it there."""
    here = threading.current_thread() is threading.main_thread()
    with _current.put_off() if _current is not None and here else nullcontext():
        if not hasattr(signal, "pthread_sigmask"):  # Windows
            yield
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def let_through() -> None:
    """In a worker: end at once and without a word, now also at what was held back; its parent says what happened."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def end_with_parent() -> None:
    """In a worker: end when the process that started it has, however that ended."""
    from multiprocessing import connection, parent_process

    parent = parent_process()
    if parent is None:
        return

    def watch() -> None:
        connection.wait([parent.sentinel])
        delete_kept_folders()
        os._exit(1)

    threading.Thread(target=watch, name="end with parent", daemon=True).start()


def forget_semaphores() -> None:
    """Before ``os._exit``: let go of what queues of processes hold, which their tracker would tell of as leaked."""
    util = sys.modules.get("multiprocessing.util")
    if util is not None:
        with suppress(Exception):  # whatever state the signal left them in
            util._run_finalizers(0)
