"""Independent jobs over the machines of a Ray cluster (extra ``ray``).

The program is installed on every machine, and all see the same folders: jobs hold paths, not arrays, and leave their
results in files. Nothing of this process's folder is shipped, so compiled kernels are found where they were kept.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from .errors import ToolError
from .parallel import Job, JobOutcome, Result, guarded, one_thread_each
from .progress import Progress

_REACHED_S = 5.0
INSTALL = "--ray needs the package ray: pip install 'maslam[ray]'"


def run_on_cluster(
    work: Callable[[Job, Callable[[int], None]], Result],
    jobs: Mapping[str, tuple[Job, int]],
    address: str,
    progress: Progress,
) -> dict[str, JobOutcome[Result]]:
    """As :func:`~.parallel.run_jobs`, each job on a core of the cluster at ``address`` (empty: that of the environment
    variable RAY_ADDRESS, else one of this machine alone). A job whose machine or process ends is tried again by Ray.

    ``ToolError`` where Ray is not installed or no cluster answers.
    """
    if not jobs:
        return {}
    with _connected(address) as ray:
        remote = ray.remote(num_cpus=1)(_there)
        waiting = {remote.remote(work, name, job): name for name, (job, _) in jobs.items()}
        tasks = {name: progress.start(name, steps) for name, (_, steps) in jobs.items()}
        done: dict[str, JobOutcome[Result]] = {}
        pending = list(waiting)
        while pending:
            finished, pending = ray.wait(pending)
            for reference in finished:
                name = waiting[reference]
                done[name] = _outcome(ray, reference)
                progress.advance(tasks[name], jobs[name][1])
    return {name: done[name] for name in jobs}


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """The module ``ray``, connected; a connection that was there before is left as it is."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as error:
        raise ToolError(INSTALL) from error
    if ray.is_initialized():
        yield ray
        return
    _check_reached(address)
    try:
        ray.init(address=address or None, log_to_driver=False, include_dashboard=False)
    except (ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
        raise ToolError(f"--ray {address}: no Ray cluster there: {_lines(error)[0]}") from error
    try:
        yield ray
    finally:
        ray.shutdown()


def _check_reached(address: str) -> None:
    """Ray itself tries for minutes where nobody listens."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), _REACHED_S).close()
    except OSError as error:
        raise ToolError(f"--ray {address}: no Ray cluster there: {_lines(error)[0]}") from error


def _outcome(ray: Any, reference: Any) -> JobOutcome[Any]:
    try:
        outcome: JobOutcome[Any] = ray.get(reference)
    except ray.exceptions.RayTaskError as error:  # it did not come as far as the job: another version there, or none
        return JobOutcome(None, ToolError(f"a machine of the cluster cannot do it: {_lines(error)[-1]}"))
    except ray.exceptions.RayError as error:
        return JobOutcome(None, ToolError(f"its process or machine ended: {_lines(error)[0]}"))
    return outcome


def _lines(error: Exception) -> list[str]:
    return [line.strip() for line in str(error).splitlines() if line.strip()] or [type(error).__name__]


def _there(work: Callable[[Any, Callable[[int], None]], Any], name: str, job: Any) -> JobOutcome[Any]:
    """On a machine of the cluster."""
    one_thread_each()
    return guarded(work, name, job, lambda level: None)
