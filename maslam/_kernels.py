"""``@kernel`` has a function compiled; what work needs is made ready before it begins; clocks leave compiling out.

numba compiles a kernel where it is first called with some types, and keeps it in a cache on disk. On an empty cache
that takes a quarter of a minute, once: it happens here, with progress, before clocks start and before workers do.
"""

from __future__ import annotations

import gc
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import parent_process
from typing import Any, TypeVar, overload

from numba import config, njit
from numba.core import event

from ._kernel_cache import cache_of, take_notes

log = logging.getLogger(__name__)
TypedKernel = tuple[Any, tuple[Any, ...]]
"""A kernel, and the types that it is called with."""
Function = TypeVar("Function", bound=Callable[..., Any])


@overload
def kernel(function: Function, /) -> Function: ...
@overload
def kernel(
    *, fastmath: bool | set[str] = ..., error_model: str = ..., inline: str = ...
) -> Callable[[Function], Function]: ...
def kernel(function: Any = None, /, **options: Any) -> Any:
    """Compile ``function`` where it is first called with some types; ``options`` are those of ``numba.njit``.

    The global interpreter lock is released while it runs. It may use numbers, text, arrays, classes, and functions of
    its package; TypeError for a global of another kind, whose changes could not be told.
    """
    if function is None:
        return lambda decorated: kernel(decorated, **options)
    compiled = njit(nogil=True, no_cfunc_wrapper=True, **options)(function)
    if not config.DISABLE_JIT:
        compiled._cache = cache_of(function)
    return compiled


class Compilations(event.Listener):
    """``seconds``: wall time that numba has spent compiling. ``begun`` is called each time it begins."""

    def __init__(self, begun: Callable[[], None] = lambda: None) -> None:
        self.seconds = 0.0
        self._begun = begun
        self._depth = 0  # a kernel compiles those that it calls
        self._since = 0.0

    def on_start(self, _: Any) -> None:
        if not self._depth:
            self._since = time.perf_counter()
            self._begun()
        self._depth += 1

    def on_end(self, _: Any) -> None:
        self._depth -= 1
        if not self._depth:
            self.seconds += time.perf_counter() - self._since


@contextmanager
def watch_compiling(begun: Callable[[], None] = lambda: None) -> Iterator[Compilations]:
    """Within the block: what numba compiles in this process. Taking a kernel from the cache is no compilation."""
    compilations = Compilations(begun)
    with event.install_listener("numba:compile", compilations):
        yield compilations


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """numba makes so many objects that searching them for garbage takes a seventh of the time; 200 MB are spent."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def make_ready(kernels: Sequence[TypedKernel], count: Callable[[int, int], None] = lambda done, total: None) -> None:
    """Take ``kernels`` from numba's cache, and compile those that are not in it.

    ``count(done, total)`` is called only where something has to be compiled. Processes that are started afterwards find
    everything in the cache, so nothing is compiled twice.
    """
    if config.DISABLE_JIT:
        return
    done = 0
    if parent_process() is None:  # workers would say it again
        for note in take_notes():
            log.warning("%s", note)
    with watch_compiling(lambda: count(done, len(kernels))) as compilations, _no_garbage_collection():
        for done, (kernel, types) in enumerate(kernels):  # noqa: B007 - told by the watch
            kernel.compile(types)
    if compilations.seconds:
        count(len(kernels), len(kernels))
        log.info("compiled kernels in %.1f s; cache: %s", compilations.seconds, kernels[0][0].stats.cache_path)
