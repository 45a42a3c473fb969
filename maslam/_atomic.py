"""Files and folders that appear whole or not at all; every result of the product is written through here.

Each is made beside its place under a name that no reader takes for a result (``.NAME.PID-N.part``) and then moved
there. Whatever interrupts this, Ctrl-C included, the place keeps what it held before. The kernel writes to the disk
when it likes: this guards against a program that ends early, not against a loss of power.
"""

from __future__ import annotations

import itertools
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_numbers = itertools.count()
_LONGEST_STEM = 200


def part_stem(name: str) -> str:
    """What the names of half-written files begin with, after the dot: ``name``, or its beginning, since a name may have
    255 bytes and no more."""
    while len(os.fsencode(name)) > _LONGEST_STEM:
        name = name[:-1]
    return name


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a free path beside ``path``. What the block makes there, a file or a folder, then replaces ``path``.

    Where the block raises, ``path`` stays as it is and what was made is removed. An ``OSError`` names ``path``.
    """
    part = path.with_name(f".{part_stem(path.name)}.{os.getpid()}-{next(_numbers)}.part")
    try:
        yield part
        _move(part, path)
    except OSError as error:
        place = _place_of(error, part, path)
        if place is not None:
            error.filename, error.filename2 = place, None
        raise
    finally:
        _remove(part)


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write one file. Text is UTF-8 with its line ends as given, also on Windows."""
    with replacing(path) as part:
        part.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def write_together(files: Iterable[tuple[Path, str | bytes]]) -> None:
    """Write several files: all are whole beside their places before the first is moved; moved in the order given."""
    with ExitStack() as moves:  # ends in reverse
        for path, content in reversed(list(files)):
            part = moves.enter_context(replacing(path))
            part.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def write_npz(path: Path, arrays: Mapping[str, ArrayLike], compressed: bool = False) -> None:
    """Write arrays by name as ``.npz``; equal arrays give equal bytes. Raises TypeError for what needs pickle."""
    import numpy as np

    plain = {name: np.asanyarray(values) for name, values in arrays.items()}
    if objects := [name for name, values in plain.items() if values.dtype.hasobject]:
        raise TypeError(f"{path}: no plain numbers or text: {', '.join(objects)}")
    save: Callable[..., None] = np.savez_compressed if compressed else np.savez
    with replacing(path) as part, part.open("wb") as file:
        save(file, **plain)


def _place_of(error: OSError, part: Path, path: Path) -> str | None:
    """What the user knows of the file that ``error`` is about; None where it names that itself. A full disk gives no
    name at all."""
    if error.filename is None or not isinstance(error.filename, str | bytes):
        return str(path)
    named = Path(os.fsdecode(error.filename))
    return str(path / named.relative_to(part)) if named.is_relative_to(part) else None


def _move(part: Path, path: Path) -> None:
    """Move in one step; a folder in the way, which no system replaces in one step, is set aside for that time."""
    if not (part.is_dir() and path.is_dir()):
        os.replace(part, path)
        return
    aside = part.with_suffix(".old.part")
    os.replace(path, aside)
    try:
        os.replace(part, path)
    except BaseException:
        os.replace(aside, path)
        raise
    shutil.rmtree(aside)


def _remove(part: Path) -> None:
    if part.is_dir():
        shutil.rmtree(part)
    else:
        part.unlink(missing_ok=True)
