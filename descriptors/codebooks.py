"""Codebooks of product quantisation (Jegou et al., PAMI 2011): made from a model's vectors, kept beside its weights.

``default.codes.npz`` belongs to ``default.onnx``: it holds that file's SHA-256, and books of other weights are refused.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maslam._atomic import write_npz
from maslam._bounded import open_npz

from .clusters import k_means
from .errors import DescriptorError

Vectors = NDArray[np.float32]

CENTRES = 256
"""Of each group of numbers: one byte names one."""
SUFFIX = ".codes.npz"
_VERSION = 1
_SHAPES = {"pq32": (32, 256), "pq16": (16, 128)}
"""Groups (bytes) and strongest axes kept, at most. Measured on held-out worlds (docs/appendix/netvlad.md): 32 bytes are
best spent on all 256 numbers, 16 on the first 128."""
_ITERATIONS = 15
_HELD_BACK = 10
"""Every so many-th vector is kept out of training to measure the fidelity on."""
_SPREAD = 0.7
"""Share of a vector's deviation that a second, blurred copy of each training vector gets at random: 256 centres for
a few thousand vectors would else follow those vectors too closely."""


@dataclass(frozen=True, eq=False)
class ProductBook:
    """``axes`` ``(d,)`` int64: which numbers of a vector are kept, group after group; ``centres`` ``(M, 256, d / M)``
    float32; ``fidelity``: mean cosine of unseen vectors to what is decoded of them."""

    axes: NDArray[np.int64]
    centres: Vectors
    fidelity: float

    def __post_init__(self) -> None:
        groups, centres, size = self.centres.shape if self.centres.ndim == 3 else (0, 0, 0)
        fits = groups * size == len(self.axes) > 0 and centres == CENTRES and 0 < self.fidelity <= 1
        if not fits or len(np.unique(self.axes)) < len(self.axes) or not np.isfinite(self.centres).all():
            raise DescriptorError(f"no codebook: {len(self.axes)} axes, centres {self.centres.shape}")

    @cached_property
    def digest(self) -> str:
        """Eight hexadecimal digits that tell two books apart."""
        data = self.axes.astype("<i8").tobytes() + self.centres.astype("<f2").tobytes()
        return hashlib.sha256(data).hexdigest()[:8]


@dataclass(frozen=True, eq=False)
class Codebooks:
    """The books of one model by code; ``sha256`` and ``dim``: of its weights and vectors; ``data``: what the books
    were made from, in words."""

    sha256: str
    dim: int
    books: dict[str, ProductBook]
    data: str = ""

    def save(self, path: Path) -> None:
        """Write as ``.npz`` without pickle, centres as float16, whole or not at all; equal books give equal bytes."""
        arrays: dict[str, ArrayLike] = {"data": self.data, "version": np.int64(_VERSION), "sha256": self.sha256}
        arrays["dim"] = np.int64(self.dim)
        for code, book in sorted(self.books.items()):
            arrays[f"{code}_axes"] = book.axes.astype("<u2")
            arrays[f"{code}_centres"] = book.centres.astype("<f2")
            arrays[f"{code}_fidelity"] = np.float64(book.fidelity)
        write_npz(path, arrays)

    @classmethod
    def load(cls, path: Path) -> Codebooks:
        """Read and check :meth:`save`'s file."""
        try:
            with open_npz(path) as file:
                fields = {key: file[key] for key in file.files}
            version = int(fields["version"])
            if version != _VERSION:
                raise DescriptorError(f"{path}: version {version} of codebooks; this program reads {_VERSION}")
            books = {code: _book(fields, code) for code in _SHAPES if f"{code}_axes" in fields}
            return cls(str(fields["sha256"]), int(fields["dim"]), books, str(fields["data"]))
        except FileNotFoundError as error:
            raise DescriptorError(f"{path}: not found") from error
        except (OSError, ValueError, EOFError, KeyError, TypeError, zipfile.BadZipFile) as error:
            raise DescriptorError(f"{path}: not a file of codebooks: {error}") from error
        except DescriptorError as error:
            raise DescriptorError(str(error) if str(path) in str(error) else f"{path}: {error}") from error


def codebooks_path(model: Path) -> Path:
    """Path of the codebooks of an ``.onnx`` file."""
    return model.with_suffix(SUFFIX)


def load_book(model: Path | None, code: str, dim: int, sha256: str) -> ProductBook:
    """The book of ``code`` beside ``model``, made for the weights ``sha256`` and vectors of ``dim`` numbers; the error
    names the command that makes one."""
    remedy = f"make them with: maslam netvlad codes {model or 'MODEL.onnx'}"
    path = codebooks_path(model) if model is not None else None
    if path is None or not path.is_file():
        raise DescriptorError(f"place code {code} needs codebooks, and {path or 'this model'} does not exist; {remedy}")
    found = Codebooks.load(path)
    if (found.sha256, found.dim) != (sha256, dim):
        raise DescriptorError(
            f"{path}: codebooks of other weights ({found.sha256[:12]}, {found.dim} numbers; "
            f"the vectors are of {sha256[:12]}, {dim}); {remedy}"
        )
    if code not in found.books:
        raise DescriptorError(f"{path}: no codebook for {code}: vectors of {dim} numbers are too short for it")
    return found.books[code]


def train_codebooks(
    vectors: Vectors, sha256: str, data: str, seed: int = 0, tick: Callable[[int, int], None] = lambda done, total: None
) -> Codebooks:
    """Books for every product code that vectors of this length allow, from ``(N, dim)`` unit rows of any images.

    ``tick(done, total)`` counts groups. An error with fewer vectors than centres; a few thousand are needed for
    good ones. Same vectors, same books.
    """
    count, dim = vectors.shape
    codes = {code: shape for code, shape in _SHAPES.items() if dim >= shape[0]}
    needed = CENTRES + CENTRES // (_HELD_BACK - 1) + 1
    if count < needed:
        raise DescriptorError(f"codebooks of {CENTRES} centres need at least {needed} vectors, got {count}")
    if not codes:
        raise DescriptorError(f"vectors of {dim} numbers are too short for product codes (at least 16)")
    total, done = sum(groups for groups, _ in codes.values()), 0

    def one_more() -> None:
        nonlocal done
        done += 1
        tick(done, total)

    books = {}
    for code, (groups, limit) in codes.items():
        books[code] = _train(vectors, groups, limit, np.random.default_rng([seed, groups]), one_more)
    return Codebooks(sha256, dim, books, data)


def _train(
    vectors: Vectors, groups: int, limit: int, rng: np.random.Generator, tick: Callable[[], None]
) -> ProductBook:
    used = min(vectors.shape[1], limit) // groups * groups
    strongest = np.sort(np.argsort(-(vectors**2).mean(axis=0), kind="stable")[:used])
    rows = vectors[:, strongest]
    rows = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12)
    apart = np.arange(len(rows)) % _HELD_BACK == _HELD_BACK - 1
    seen, unseen = rows[~apart], rows[apart]
    order = balanced_groups((seen**2).mean(axis=0), groups)
    spread = np.linalg.cholesky(np.cov(seen.T) + 1e-9 * np.eye(used)).astype(np.float32)
    random = rng.standard_normal(seen.shape, dtype=np.float32) @ spread.T
    blurred = np.float32((1.0 - _SPREAD**2) ** 0.5) * seen + np.float32(_SPREAD) * random
    material = np.concatenate([seen, blurred])[:, order]
    centres = []
    for group in np.split(material, groups, axis=1):
        centres.append(k_means(np.ascontiguousarray(group), CENTRES, _ITERATIONS, rng))
        tick()
    book = ProductBook(strongest[order], np.stack(centres).astype(np.float16).astype(np.float32), 1.0)
    return ProductBook(book.axes, book.centres, _fidelity(book, unseen[:, order]))


def balanced_groups(power: NDArray[np.floating], groups: int) -> NDArray[np.int64]:
    """Axes ``(d,)`` in the order of their groups: equally many in each, products of their powers alike.

    Equal bytes are worth most on groups of equal volume (Ge et al., Optimized Product Quantization, CVPR 2013). A
    learned rotation on top brought nothing that held-out worlds could show.
    """
    size = len(power) // groups
    members: list[list[int]] = [[] for _ in range(groups)]
    volume = np.zeros(groups)
    for axis in np.argsort(-power, kind="stable"):
        open_groups = [g for g in range(groups) if len(members[g]) < size]
        chosen = min(open_groups, key=lambda g: (volume[g], g))
        members[chosen].append(int(axis))
        volume[chosen] += np.log(max(float(power[axis]), 1e-12) * len(power))
    return np.concatenate([np.array(one, dtype=np.int64) for one in members])


def _fidelity(book: ProductBook, rows: Vectors) -> float:
    parts = []
    for centres, group in zip(book.centres, np.split(rows, len(book.centres), axis=1), strict=True):
        nearest = (0.5 * (centres**2).sum(axis=1) - group @ centres.T).argmin(axis=1)
        parts.append(centres[nearest])
    decoded = np.concatenate(parts, axis=1)
    cosine = (decoded * rows).sum(axis=1) / np.maximum(np.linalg.norm(decoded, axis=1), 1e-12)
    return round(float(np.clip(cosine.mean(), 1e-3, 1.0)), 4)


def _book(fields: dict[str, NDArray], code: str) -> ProductBook:
    return ProductBook(
        fields[f"{code}_axes"].astype(np.int64),
        fields[f"{code}_centres"].astype(np.float32),
        float(fields[f"{code}_fidelity"]),
    )
