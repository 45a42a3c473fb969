"""Destinations of log lines. Modules write to ``logging.getLogger(__name__)``; only the command line attaches handlers.

Lines of worker processes are handled in the process that started them, so that a log file has one writer and the lines
on a terminal stand above the progress bars.
"""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from logging.handlers import QueueHandler
from pathlib import Path
from queue import Empty
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multiprocessing.context import BaseContext

LEVELS = {
    "error": logging.ERROR,
    "warning": logging.WARNING,
    "info": logging.INFO,
    "debug": logging.DEBUG,
}
OURS = ("maslam",)
"""The loggers whose level is set: libraries log from ``warning`` on, whatever is asked for."""
ON_CONSOLE = {"on_console": True}
"""``extra`` of a line that stands on the console already: it goes to the log file only."""
_FORMAT = "%(asctime)s %(levelname)-7s [%(process)d] %(name)s: %(job)s%(message)s"
_POLL_S, _LAST_LINES_S = 0.1, 2.0
_job = ""  # what this process works on, when it works on one of several things


@contextmanager
def without_warnings_of(library: str) -> Iterator[None]:
    """Of what ``library`` logs meanwhile only errors count."""
    logger = logging.getLogger(library)
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


@contextmanager
def working_on(name: str) -> Iterator[None]:
    """Lines that are logged meanwhile begin with ``name``: they are about one of several jobs."""
    global _job
    before, _job = _job, f"{name}: "
    try:
        yield
    finally:
        _job = before


def _with_job(record: logging.LogRecord) -> bool:
    """A filter that drops nothing: it notes the job, in the process in which it is done."""
    record.job = getattr(record, "job", _job)
    return True


class _ConsoleHandler(logging.Handler):
    """To standard error as it is at that moment: while bars are shown, rich puts a stream there that prints above
    them.
    """

    def emit(self, record: logging.LogRecord) -> None:
        if getattr(record, "on_console", False):
            return
        try:
            text = " ".join(record.getMessage().split())
            where = "" if record.levelno == logging.WARNING else f"{record.name}: "
            sys.stderr.write(f"{record.levelname.lower()}: {where}{vars(record)['job']}{text}\n")
            sys.stderr.flush()
        except Exception:  # noqa: BLE001 - a line that cannot be written must not end the work
            self.handleError(record)


def _file_handler(path: Path, level: int) -> logging.Handler:
    """Times in UTC with milliseconds, so that logs of several machines can be laid side by side."""
    formatter = logging.Formatter(_FORMAT)
    formatter.converter = time.gmtime
    formatter.default_time_format, formatter.default_msec_format = "%Y-%m-%dT%H:%M:%S", "%s.%03dZ"
    handler = logging.FileHandler(path, encoding="utf-8")
    handler.setLevel(level)
    handler.setFormatter(formatter)
    return handler


@contextmanager
def logs_to(level: str | None = None, file: Path | None = None) -> Iterator[None]:
    """Log lines from ``level`` on (one of ``LEVELS``) go to standard error and are appended to ``file``.

    Without a level: from ``warning`` on, and from ``info`` on in the file. ``OSError`` where the file cannot be opened.
    """
    handlers: list[logging.Handler] = [_ConsoleHandler(LEVELS[level or "warning"])]
    if file is not None:
        handlers.append(_file_handler(file, LEVELS[level or "info"]))
    before = {name: logging.getLogger(name).level for name in OURS}
    root = logging.getLogger()
    for handler in handlers:
        handler.addFilter(_with_job)
        root.addHandler(handler)
    _set_levels(dict.fromkeys(OURS, min(handler.level for handler in handlers)))
    logging.captureWarnings(True)
    try:
        yield
    finally:
        logging.captureWarnings(False)
        _set_levels(before)
        for handler in handlers:
            root.removeHandler(handler)
            handler.close()


@dataclass(frozen=True)
class Relay:
    """Values with which a worker process sends its log lines to its parent: the queue, and the level of each of our
    loggers."""

    queue: Any
    levels: dict[str, int]

    def attach(self) -> None:
        """In the worker: every line goes into the queue."""
        root = logging.getLogger()
        handler = QueueHandler(self.queue)
        handler.addFilter(_with_job)
        root.handlers = [handler]
        _set_levels(self.levels)
        logging.captureWarnings(True)


@contextmanager
def collected_logs(context: BaseContext) -> Iterator[Relay]:
    """A relay for worker processes of ``context``; what they log is handled here, in the order in which it arrives.

    At the end the lines of workers that have ended are all there; those of workers that were stopped may be lost.
    """
    queue, ended = context.Queue(), threading.Event()
    reader = threading.Thread(target=_handle_all, args=(queue, ended), name="worker logs", daemon=True)
    reader.start()
    limit: float | None = _LAST_LINES_S  # a worker that was stopped may have left half a line
    try:
        yield Relay(queue, {name: logging.getLogger(name).getEffectiveLevel() for name in OURS})
        limit = None
    finally:
        ended.set()
        reader.join(limit)
        queue.close()


def _handle_all(queue: Any, ended: threading.Event) -> None:
    while True:
        try:
            record = queue.get(timeout=_POLL_S)
        except Empty:
            if ended.is_set():
                return
            continue
        except (OSError, EOFError, ValueError):  # closed under our hands
            return
        logging.getLogger(record.name).handle(record)


def _set_levels(levels: dict[str, int]) -> None:
    for name, level in levels.items():
        logging.getLogger(name).setLevel(level)
