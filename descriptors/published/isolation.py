"""A reader in a process of its own: a damaged file may end that process, never the caller's."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from ..errors import DescriptorError
from .vgg_weights import Convolution, VggWeights

REFUSED = 3
_MEMORY_BYTES = 16 << 30


@contextmanager
def read_apart(module: str, path: Path, dim: int | None) -> Iterator[Path]:
    """What ``python -m module PATH DIM OUT`` writes to OUT within the block; its standard error is what is wrong with
    ``path``, where it ends with :data:`REFUSED`. :class:`DescriptorError` for that, and where it is ended otherwise."""
    with tempfile.TemporaryDirectory(prefix="maslam-") as folder:
        out = Path(folder) / "weights.npz"
        words = [sys.executable, "-m", module, str(path), "all" if dim is None else str(dim), str(out)]
        paths = os.pathsep.join([entry for entry in sys.path if entry])
        done = subprocess.run(words, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, check=False)
        said = done.stderr.decode("utf-8", "replace").strip()
        if done.returncode == REFUSED:
            raise DescriptorError(said.splitlines()[-1] if said else f"{path}: cannot be read")
        if done.returncode != 0:
            raise DescriptorError(f"{path}: damaged: its reader was ended by it ({_how(done.returncode)})")
        yield out


def _how(code: int) -> str:
    with suppress(ValueError):
        if code < 0:
            return signal.Signals(-code).name
    return f"exit code {code}"


def limit_memory() -> None:
    """In the reader's process: a file that claims more than there is ends in an error, not in the machine's."""
    with suppress(ImportError, OSError, ValueError):  # Windows has no such limit; a lower one may be set
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))


def save_weights(out: Path, weights: VggWeights) -> None:
    """For :func:`load_weights`."""
    arrays = {
        name: getattr(weights, name)
        for name in ("mean", "deviation", "assign", "assign_bias", "centres", "whitening", "whitening_bias")
        if getattr(weights, name) is not None
    }
    for k, one in enumerate(weights.convolutions):
        arrays[f"weight_{k}"], arrays[f"bias_{k}"] = one.weight, one.bias
    np.savez(out, softening=np.float64(weights.softening), **arrays)


def load_weights(out: Path) -> VggWeights:
    """What :func:`save_weights` wrote."""
    with np.load(out, allow_pickle=False) as stored:
        count = sum(name.startswith("weight_") for name in stored.files)
        rest = {name: stored[name] for name in stored.files if not name.startswith(("weight_", "bias_", "softening"))}
        return VggWeights(
            convolutions=tuple(Convolution(stored[f"weight_{k}"], stored[f"bias_{k}"]) for k in range(count)),
            softening=float(stored["softening"]),
            whitening=rest.pop("whitening", None),
            whitening_bias=rest.pop("whitening_bias", None),
            **rest,
        )
