"""Importing a library that takes over this process's signals, without letting it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_TAKEN = ("SIGTERM", "SIGINT", "SIGHUP")


@contextmanager
def signals_kept() -> Iterator[None]:
    """Within the block, signals that end a process wait; after it, their handlers are those of before.

    pycolmap's logging library (glog) sets a handler for SIGTERM of its own when it is imported, which prints where each
    function stood and ends the process, past Python. Python does not notice; so the handlers are set again. Other
    threads than the main one may set none: there only the block itself is covered.
    """
    numbers = [getattr(signal, name) for name in _TAKEN if hasattr(signal, name)]
    masked = hasattr(signal, "pthread_sigmask")  # not on Windows
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, numbers) if masked else set()
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number in numbers:
                handler = signal.getsignal(number)
                if handler is not None:  # None: set by compiled code before
                    signal.signal(number, handler)
        if masked:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
