"""Independent jobs over the cores of one machine, in processes of their own: few long ones, or many small ones."""

from __future__ import annotations

import errno
import logging
import multiprocessing
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from multiprocessing.context import SpawnContext, SpawnProcess
from queue import Empty
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from .errors import ToolError, describe
from .interrupts import end_with_parent, held_back, let_through
from .logs import Relay, collected_logs, working_on
from .progress import Progress

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

Job = TypeVar("Job")
Result = TypeVar("Result")
POLL_S = 0.2
_LAST_BREATH_S = 3.0
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_MOST_WORKERS_ON_WINDOWS = 61  # what one call can wait for there
_WORKER_ENDED = (
    "a worker process ended: killed, or out of memory (fewer --workers need less); a script of your own must start "
    'its work under `if __name__ == "__main__":`'
)
_OF_THE_PROCESS = {errno.EMFILE, errno.ENFILE, errno.EAGAIN, errno.ENOMEM}
_NO_WORKERS = "no worker processes can be started"
log = logging.getLogger(__name__)
_levels: Any = None  # in a worker: the queue on which it tells how far it is
_work: Any = None  # in a worker: what it does with each small job


@dataclass(frozen=True)
class JobOutcome(Generic[Result]):
    """Outcome of one job: its result, or the error that ended it."""

    result: Result | None
    error: Exception | None


@contextmanager
def one_blas_thread(libraries: ThreadpoolController | None = None) -> Iterator[None]:
    """BLAS and OpenMP on one thread inside the block: with more, sums are taken in another order, and results depend
    on the machine and its load. Cores are used by processes instead (:func:`run_jobs`).

    ``libraries``: those loaded before, for a block that is short and entered often: looking for them takes 10 ms.
    """
    from threadpoolctl import threadpool_limits

    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))  # libraries loaded from here on, and child processes
    try:
        with threadpool_limits(1) if libraries is None else libraries.limit(limits=1):  # libraries that are loaded
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def core_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_jobs(
    work: Callable[[Job, Callable[[int], None]], Result],
    jobs: Mapping[str, tuple[Job, int]],
    workers: int,
    progress: Progress,
    fresh: bool = False,
) -> dict[str, JobOutcome[Result]]:
    """``work(job, advance)`` for each named job (with its number of steps), the outcomes in the order of ``jobs``.

    A failing job does not stop the others. With one worker or one job, and where no process can be started, everything
    happens in this process, but with ``fresh`` each job gets a new process of its own: what it measures is its own.
    ``work`` must be a function of a module, its jobs and results picklable; results must not depend on which worker
    made them.
    """
    tasks = {name: progress.start(name, steps) for name, (_, steps) in jobs.items()}
    if min(workers, len(jobs)) <= 1 and not fresh:
        return {
            name: guarded(work, name, job, partial(progress.advance, tasks[name])) for name, (job, _) in jobs.items()
        }
    try:
        return _in_pool(work, jobs, workers, progress, tasks, fresh)
    except _NoWorkersError as error:
        if fresh:
            raise ToolError(f"{_NO_WORKERS}: {error}") from error
        log.warning("%s: %s; this one does all the work", _NO_WORKERS, error)
        return run_jobs(work, jobs, 1, progress)


def _in_pool(
    work: Callable[[Job, Callable[[int], None]], Result],
    jobs: Mapping[str, tuple[Job, int]],
    workers: int,
    progress: Progress,
    tasks: dict[str, int],
    fresh: bool,
) -> dict[str, JobOutcome[Result]]:
    context = _context()
    with _starting():
        levels = context.Queue()
    with _pool(min(workers, len(jobs)), context, partial(_prepare_worker, levels), 1 if fresh else None) as pool:
        with _starting():
            futures = {pool.submit(_in_worker, work, name, job): name for name, (job, _) in jobs.items()}
        _watch(futures, levels, tasks, progress)
        done = {name: future.result() for future, name in futures.items()}
    return {name: done[name] for name in jobs}


@contextmanager
def _starting() -> Iterator[None]:
    """What keeps worker processes, and the queues to them, from being made is a :class:`_NoWorkersError`."""
    try:
        yield
    except (OSError, ImportError) as error:  # Python lacks semaphores where there was none when it was built
        where = "" if getattr(error, "errno", None) in _OF_THE_PROCESS else "/dev/shm (docker: --shm-size): "
        raise _NoWorkersError(f"{where}{describe(error)}") from error


def each_finished(work: Callable[[Job], None], jobs: Iterable[Job], workers: int) -> Iterator[None]:
    """``work(job)`` for each of many small jobs; yields each time one is done, in whatever order. The first error ends
    all.

    ``work`` goes to each worker once and may keep there what it prepares. With one worker, and where none can be
    started, everything happens in this process.
    """
    if workers <= 1:
        for job in jobs:
            work(job)
            yield
        return
    jobs = list(jobs)
    done = 0
    try:
        for _ in _each_in_pool(work, jobs, workers):
            done += 1
            yield
    except _NoWorkersError as error:
        if done:
            raise ToolError(f"{_NO_WORKERS}: {error}") from error
        log.warning("%s: %s; this one does all the work", _NO_WORKERS, error)
        yield from each_finished(work, jobs, 1)


def _each_in_pool(work: Callable[[Job], None], jobs: Sequence[Job], workers: int) -> Iterator[None]:
    queue = iter(jobs)
    with _pool(workers, _context(), partial(_keep, work)) as pool:
        with _starting():
            pending = {pool.submit(_kept, job) for job in islice(queue, 4 * workers)}
        while pending:
            finished, pending = wait(pending, return_when=FIRST_COMPLETED)
            pending |= {pool.submit(_kept, job) for job in islice(queue, len(finished))}
            for future in finished:
                yield future.result()


class _NoWorkersError(Exception):
    """No process can be started here, or nothing be sent between processes."""


class WorkerProcess(SpawnProcess):
    """A process that is started without the terminal's Ctrl-C, at which it would tell where it was."""

    def start(self) -> None:
        with held_back():
            super().start()


class WorkerContext(SpawnContext):
    """How processes are started: anew, with nothing of this one in them."""

    Process = WorkerProcess


def _context() -> SpawnContext:
    """How processes are started. A worker that imports its parent's script, which starts workers again, ends here: its
    parent says what is wrong.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        sys.exit(1)
    return WorkerContext()


@contextmanager
def _pool(
    workers: int, context: Any, prepare: Callable[[], None], jobs_each: int | None = None
) -> Iterator[ProcessPoolExecutor]:
    """A pool of processes that is gone at the end, at once where the end is an error."""
    workers = min(workers, _MOST_WORKERS_ON_WINDOWS) if sys.platform == "win32" else workers
    with ExitStack() as logs:
        with _starting():
            relay = logs.enter_context(collected_logs(context))
            pool = ProcessPoolExecutor(workers, context, _settle_in, (relay, prepare), max_tasks_per_child=jobs_each)
        try:
            yield pool
        except BaseException as error:
            pool.shutdown(wait=False, cancel_futures=True)
            children = multiprocessing.active_children()
            for child in children:
                child.terminate()
            for child in children:  # they may hold files half-written, which the caller removes
                child.join(_LAST_BREATH_S)
            if isinstance(error, BrokenProcessPool):
                raise ToolError(_WORKER_ENDED) from error
            raise
        pool.shutdown()


def _watch(
    futures: dict[Future[JobOutcome[Result]], str], levels: Any, tasks: dict[str, int], progress: Progress
) -> None:
    waiting = set(futures)
    while waiting:
        _, waiting = wait(waiting, timeout=POLL_S, return_when=FIRST_COMPLETED)
        latest: dict[str, int] = {}
        try:
            while True:
                name, level = levels.get_nowait()
                latest[name] = level
        except Empty:
            pass
        for name, level in latest.items():
            progress.advance(tasks[name], level)


def _prepare_worker(levels: Any) -> None:
    global _levels
    _levels = levels


def _keep(work: Any) -> None:
    global _work
    _work = work


def _kept(job: Any) -> None:
    _work(job)


def _settle_in(relay: Relay, prepare: Callable[[], None]) -> None:
    end_with_parent()
    let_through()
    relay.attach()
    prepare()
    one_thread_each()


def one_thread_each() -> None:
    """In a worker: every library on one thread, from now on. With more, results depend on the machine and its load."""
    import cv2
    from threadpoolctl import threadpool_limits

    os.environ.update(dict.fromkeys(_THREADS, "1"))
    threadpool_limits(1)
    cv2.setNumThreads(1)


def _in_worker(work: Callable[[Job, Callable[[int], None]], Result], name: str, job: Job) -> JobOutcome[Result]:
    return guarded(work, name, job, lambda level: _levels.put((name, level)))


def guarded(
    work: Callable[[Job, Callable[[int], None]], Result], name: str, job: Job, advance: Callable[[int], None]
) -> JobOutcome[Result]:
    """Do one job; what ends it is its outcome."""
    try:
        with working_on(name):
            return JobOutcome(work(job, advance), None)
    except Exception as error:  # noqa: BLE001 - whatever ended this job, the others go on; the caller decides
        error.add_note(traceback.format_exc())  # a process of its own takes the traceback with it; --debug shows this
        return JobOutcome(None, error)
