"""Compiled kernels on disk: taken only while everything that they are made of is as it was.

numba's own cache looks at the file of the kernel alone. A kernel that calls another from a second file kept the old
code of that one (its result was wrong by millimetres), and an index written just before a process was ended pointed to
older code. Here the name of a cached file carries a hash of everything that is compiled into it.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core.caching import FunctionCache, IndexDataCacheFile
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

    def save_overload(self, signature: Any, data: Any) -> None:
        super().save_overload(signature, data)
        for file in Path(self._cache_path).glob(self._of_any_source):
            if not file.name.startswith(self._own):
                file.unlink(missing_ok=True)


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
