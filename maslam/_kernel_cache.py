"""Compiled kernels on disk: taken only while everything that they are made of is as it was.

numba's own cache looks at the file of the kernel alone. A kernel that calls another from a second file kept the old
code of that one (its result was wrong by millimetres), and an index written just before a process was ended pointed to
older code. Here the name of a cached file carries a hash of everything that is compiled into it.

Where neither the installation nor the user's cache can be written, kernels are kept in a folder of the user's own under
the system's temporary one; where that cannot be had either, they are compiled in each process.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import config
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.dispatcher import Dispatcher


class KernelCache(FunctionCache):
    """numba's cache of one kernel, under names that tell what the kernel is made of.

    TypeError for a global of the kernel whose changes could not be told.
    """

    def __init__(self, function: FunctionType) -> None:
        super().__init__(function)
        stamp = source_stamp(function)
        name, _, tail = self._impl.filename_base.rpartition("-")
        python = tail.partition(".")[2]
        self._of_any_source = f"{name}-*.{python}.*"
        self._own = f"{name}-{stamp}.{python}"
        self._cache_file = IndexDataCacheFile(self._cache_path, self._own, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """None where it is not there, or cannot be read: then it is compiled."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # noqa: BLE001 - whatever a damaged file of pickled code leads to
            with suppress(OSError):
                self._cache_file.flush()  # its index, which would be read again before it is written
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """A full disk ends no run: what is not kept is compiled again."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _say_once(f"{self._cache_path}: compiled kernels cannot be kept: {error.strerror}; {CURE}")
            return
        for file in Path(self._cache_path).glob(self._of_any_source):
            if not file.name.startswith(self._own):
                file.unlink(missing_ok=True)


CURE = "NUMBA_CACHE_DIR names a folder for them"
_notes: list[str] = []


def take_notes() -> list[str]:
    """What is to be said of the cache, once: it is not where it should be."""
    said = [note for note in _notes if note]
    _notes[:] = [""] * len(_notes)
    return said


def _say_once(note: str) -> None:
    if not _notes:
        _notes.append(note)


def cache_of(function: FunctionType) -> KernelCache | NullCache:
    """The cache of one kernel, wherever one can be had."""
    try:
        return KernelCache(function)
    except RuntimeError:  # numba's: no locator available
        pass
    folder = temporary_folder()
    if folder is not None:
        config.CACHE_DIR = str(folder)
        try:
            cache = KernelCache(function)
        except RuntimeError:
            pass
        else:
            why = "neither the installation nor the home folder can be written"
            _say_once(f"{why}: compiled kernels are kept in {folder}; {CURE}")
            return cache
    _say_once(f"no folder can be written: kernels are compiled anew in each process; {CURE}")
    return NullCache()


def temporary_folder() -> Path | None:
    """A folder that nobody else can write, under the system's temporary one: what is cached is executed."""
    user = os.getuid() if hasattr(os, "getuid") else "me"
    try:
        folder = Path(tempfile.gettempdir()) / f"maslam-kernels-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return None
    mine = not hasattr(os, "getuid") or (status.st_uid == os.getuid() and not status.st_mode & 0o022)
    return folder if stat.S_ISDIR(status.st_mode) and mine else None


def source_stamp(function: FunctionType) -> str:
    """A hash of all that is compiled into ``function``: the source files of the functions that it calls, itself
    included, and the values of their globals. It is taken before the rest of the function's own file has run."""
    parts = {part for called in _called(function) for part in _made_of(called)}
    return hashlib.sha256("\n".join(sorted(parts)).encode()).hexdigest()[:16]


def _called(function: FunctionType) -> list[FunctionType]:
    """``function`` and the kernels that it calls, directly or not."""
    found = [function]
    for caller in found:
        values = (value.py_func for value in _globals(caller).values() if isinstance(value, Dispatcher))
        found += [value for value in values if value not in found]
    return found


def _made_of(function: FunctionType) -> Iterator[str]:
    package = function.__module__.partition(".")[0]
    yield _digest(inspect.getfile(function))
    if function.__closure__:
        raise TypeError(f"{function.__qualname__}: variables of a function around it, whose changes are not told")
    for name, value in _globals(function).items():
        if isinstance(value, Dispatcher):
            continue  # its own file is told
        if isinstance(value, ModuleType):
            if value.__name__.partition(".")[0] == package:
                raise TypeError(f"{function.__qualname__}: import what it uses of {value.__name__} by name")
        elif isinstance(value, (*_PLAIN, tuple, np.ndarray)):
            yield f"{name}={_constant(function, name, value)}"
        elif callable(value):  # a class, a function of another library, an intrinsic of numba's
            module = inspect.getmodule(value)
            if module is not None and module.__name__.partition(".")[0] == package:
                yield _digest(inspect.getfile(module))
        else:
            raise _not_told(function, name, value)


_PLAIN = (bool, int, float, complex, str, bytes, np.generic)


def _constant(function: FunctionType, name: str, value: Any) -> str:
    """Every digit of a constant: numpy's ``repr`` leaves out most of a long array, also inside a tuple."""
    if isinstance(value, tuple):
        return f"({', '.join(_constant(function, name, one) for one in value)})"
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, _PLAIN):
        return repr(value)
    raise _not_told(function, name, value)


def _not_told(function: FunctionType, name: str, value: Any) -> TypeError:
    return TypeError(f"{function.__qualname__}: {name} is a {type(value).__name__}, whose changes are not told")


def _globals(function: FunctionType) -> dict[str, Any]:
    """The globals that ``function`` uses, as far as they exist yet."""
    known = function.__globals__
    return {name: known[name] for code in _codes(function.__code__) for name in code.co_names if name in known}


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


@cache
def _digest(file: str) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()
