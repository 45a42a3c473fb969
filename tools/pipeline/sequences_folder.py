"""The SEQS folder while it is made: whose it is, and what is being made there."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maslam._atomic import write_atomically

from ..common.errors import ToolError
from .earlier_result import BEGUN

if TYPE_CHECKING:
    from maslam.mas.manifest import SplitEntry

FRONTEND = "frontend"  # in OUT: what the front end made of each sequence


def check_free(out: Path) -> None:
    """Refuse a folder with somebody else's files in it."""
    from maslam.mas.manifest import MANIFEST

    ours = (out / FRONTEND).is_dir() or (out / MANIFEST).is_file() or (out / BEGUN).is_file()
    if out.is_dir() and any(out.iterdir()) and not ours:
        raise ToolError(f"{out}: not empty, and no folder of agent sequences")


def sequences_made_of(source: Path, split: SplitEntry | None, settings: dict[str, Any]) -> dict[str, Any]:
    """Source and settings of a SEQS folder that is to be made, as its manifest will have them."""
    cut = None if split is None else split.model_dump(mode="json")
    return {"source": str(source.resolve()), "split": cut, "settings": settings}


@contextmanager
def begun(out: Path, made_of: Mapping[str, Any]) -> Iterator[None]:
    """Until the block ends without an exception, a file in ``out`` says what is being made there."""
    mark = out / BEGUN
    write_atomically(mark, json.dumps(made_of, indent=2) + "\n")
    try:
        yield
    except BaseException:
        store = out / FRONTEND
        if {path.name for path in out.iterdir()} <= {BEGUN, FRONTEND} and not (store.is_dir() and any(store.iterdir())):
            mark.unlink(missing_ok=True)  # nothing came of it
        raise
    mark.unlink(missing_ok=True)
