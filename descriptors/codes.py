"""Place vectors as few bytes: what agents send each other instead of 1024 bytes of float32. numpy only.

``float32`` and ``int8`` keep every number, ``int4`` packs two into a byte; ``x128`` keeps the first 128 numbers only
(a model's strongest axes come first); ``pq32`` and ``pq16`` are product quantisation (Jegou et al., PAMI 2011) with
codebooks made for the model (:mod:`maslam.descriptors.codebooks`). Only the sender's vector is coded: the receiver
compares it with its own exact vectors (asymmetric comparison).

Vectors have unit length, so integer codes need no scale beside them: what is decoded is brought to unit length again.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .errors import DescriptorError

if TYPE_CHECKING:
    from .codebooks import ProductBook
    from .inference import NetVlad

Vectors = NDArray[np.float32]
Codes = NDArray[np.uint8]

CODES = ("float32", "float32x128", "int8", "int8x128", "int4", "pq32", "pq16")
"""The codes there are, finest first; ``xN`` with any other N is understood too."""
PRODUCT_CODES = ("pq32", "pq16")
_SCALAR = re.compile(r"(float32|int8|int4)(?:x([1-9]\d{0,4}))?")
INT4_STEP = 0.37
"""Quantiser step of int4 in standard deviations of a vector's numbers: of the steps .25 to .5 the one that keeps the
direction best (cosine .992 to the original; 16 levels reach 2.96 deviations)."""
_UNIT_TOLERANCE = 1e-2


def is_code(name: str) -> bool:
    """Whether there is a code of this name; whether a model has what it needs is not asked."""
    return name in PRODUCT_CODES or _SCALAR.fullmatch(name) is not None


class Coder(ABC):
    """One code for the vectors of one model. ``key`` names the code and, where it has any, its codebook: two agents
    with equal model and key understand each other."""

    def __init__(self, code: str, dim: int, axes: NDArray[np.int64], count: int) -> None:
        self.code, self.dim, self.bytes = code, dim, count
        self._axes = axes

    @staticmethod
    def of(model: str | Path | NetVlad, code: str) -> Coder:
        """The coder of a shipped model by name, of a user's by its ``.onnx`` file, or of a loaded one; codebooks are
        read from beside the model."""
        from .card import read_card

        path, card = read_card(model) if isinstance(model, str | Path) else (model.path, model.card)
        return Coder.make(code, card.dim, card.sha256, path)

    @staticmethod
    def make(code: str, dim: int, sha256: str, model: Path | None) -> Coder:
        """The coder for vectors of ``dim`` numbers made by the weights ``sha256``. ``model``: the ``.onnx`` file
        beside which product codes look for their codebooks; other codes read nothing."""
        if code in PRODUCT_CODES:
            from .codebooks import load_book

            return ProductCoder(code, dim, load_book(model, code, dim, sha256))
        found = _SCALAR.fullmatch(code)
        if found is None:
            raise DescriptorError(f"there is no place code {code!r}; there are {', '.join(CODES)}")
        used = int(found[2] or dim)
        if used > dim:
            raise DescriptorError(f"place code {code} takes the first {used} numbers, but the vectors have {dim}")
        kinds: dict[str, type[_ScalarCoder]] = {"float32": Float32Coder, "int8": Int8Coder, "int4": Int4Coder}
        return kinds[found[1]](code, dim, used)

    @property
    def key(self) -> str:
        """Name of the code and, where it has any, of its codebook."""
        return self.code

    @property
    def whole(self) -> bool:
        """Whether decoded vectors are compared with whole vectors (True) or with :meth:`cut` ones."""
        return len(self._axes) == self.dim

    def cut(self, vectors: Vectors) -> Vectors:
        """The numbers of exact vectors ``(N, dim)`` that the code keeps, unit rows ``(N, d)``: what decoded vectors
        compare with."""
        return vectors if self.whole else _unit(vectors[:, self._axes])

    def encode(self, vectors: Vectors) -> Codes:
        """Unit rows ``(N, dim)`` as ``(N, bytes)`` uint8; a row's bytes do not depend on the others."""
        rows = np.asarray(vectors, dtype=np.float32)
        if rows.ndim != 2 or rows.shape[1] != self.dim:
            raise DescriptorError(f"place code {self.code} is for vectors of {self.dim} numbers, got {rows.shape}")
        if not np.isfinite(rows).all():
            raise DescriptorError(f"place code {self.code}: a vector is not finite")
        return self._encode(self.cut(rows))

    def decode(self, codes: Codes) -> Vectors:
        """Codes ``(N, bytes)`` as unit rows ``(N, d)``; an error where the bytes are no such code."""
        rows = np.asarray(codes)
        if rows.dtype != np.uint8 or rows.ndim != 2 or rows.shape[1] != self.bytes:
            raise DescriptorError(f"place code {self.code} has {self.bytes} bytes, got {rows.shape} {rows.dtype}")
        return self._decode(np.ascontiguousarray(rows))

    def restored(self, distance: float) -> float:
        """The distance between two exact vectors that a distance to a decoded one stands for.

        A coarse code turns every vector away a little, also from those of its own place; thresholds are for exact
        ones.
        """
        return distance

    @abstractmethod
    def _encode(self, vectors: Vectors) -> Codes: ...

    @abstractmethod
    def _decode(self, codes: Codes) -> Vectors: ...


class _ScalarCoder(Coder):
    """One number after the other."""

    bits = 8

    def __init__(self, code: str, dim: int, used: int) -> None:
        super().__init__(code, dim, np.arange(used), (used * self.bits + 7) // 8)


class Float32Coder(_ScalarCoder):
    """The numbers as they are, little-endian."""

    bits = 32

    def _encode(self, vectors: Vectors) -> Codes:
        return np.ascontiguousarray(vectors, dtype="<f4").view(np.uint8).reshape(len(vectors), self.bytes)

    def _decode(self, codes: Codes) -> Vectors:
        rows = codes.view("<f4").astype(np.float32)
        if not np.isfinite(rows).all() or (np.abs(np.linalg.norm(rows, axis=1) - 1.0) > _UNIT_TOLERANCE).any():
            raise DescriptorError(f"place code {self.code}: a vector is not of length 1")
        return rows


class Int8Coder(_ScalarCoder):
    """The largest number of a vector becomes 127, all others in proportion: each is off by at most 1/254 of it."""

    def _encode(self, vectors: Vectors) -> Codes:
        largest = np.maximum(np.abs(vectors).max(axis=1, keepdims=True, initial=0.0), 1e-30)
        return np.rint(vectors / largest * np.float32(127.0)).astype(np.int8).view(np.uint8)

    def _decode(self, codes: Codes) -> Vectors:
        rows = codes.view(np.int8).astype(np.float32)
        if not rows.any(axis=1).all():
            raise DescriptorError(f"place code {self.code}: a vector of zeros has no direction")
        return _unit(rows)


class Int4Coder(_ScalarCoder):
    """16 levels without a zero, ``(k + 1/2) step``: off by half a step at most, up to eight steps from zero."""

    bits = 4

    def _encode(self, vectors: Vectors) -> Codes:
        count, used = vectors.shape
        levels = np.clip(np.floor(vectors * np.float32(np.sqrt(used) / INT4_STEP)), -8, 7).astype(np.int8) + 8
        even = np.zeros((count, 2 * self.bytes), dtype=np.uint8)
        even[:, :used] = levels
        return np.asarray(even[:, ::2] | even[:, 1::2] << 4, dtype=np.uint8)

    def _decode(self, codes: Codes) -> Vectors:
        levels = np.stack([codes & 15, codes >> 4], axis=2).reshape(len(codes), -1)[:, : len(self._axes)]
        return _unit(levels.astype(np.float32) - np.float32(7.5))


class ProductCoder(Coder):
    """Groups of numbers, each replaced by the nearest of 256 centres."""

    def __init__(self, code: str, dim: int, book: ProductBook) -> None:
        super().__init__(code, dim, np.sort(book.axes), len(book.centres))
        self._book = book
        self._place = np.searchsorted(self._axes, book.axes)

    @property
    def key(self) -> str:
        """See :attr:`Coder.key`."""
        return f"{self.code}-{self._book.digest}"

    def restored(self, distance: float) -> float:
        """See :meth:`Coder.restored`."""
        cosine = (1.0 - 0.5 * distance**2) / self._book.fidelity
        return float(np.sqrt(max(2.0 - 2.0 * cosine, 0.0)))

    def _encode(self, vectors: Vectors) -> Codes:
        groups = vectors[:, self._place].reshape(len(vectors), self.bytes, 1, -1)
        out = np.zeros((len(vectors), self.bytes), dtype=np.uint8)
        for row, one in enumerate(groups):
            out[row] = ((self._book.centres - one) ** 2).sum(axis=2).argmin(axis=1)
        return out

    def _decode(self, codes: Codes) -> Vectors:
        self._check(codes)
        out = np.zeros((len(codes), len(self._axes)), dtype=np.float32)
        out[:, self._place] = self._book.centres[np.arange(self.bytes), codes].reshape(len(codes), -1)
        return _unit(out)

    def _check(self, codes: Codes) -> None:
        if codes.size and int(codes.max()) >= self._book.centres.shape[1]:
            raise DescriptorError(f"place code {self.code}: no centre {int(codes.max())}")


def _unit(rows: Vectors) -> Vectors:
    # Rows in a row of memory: else their sums would depend on how many there are.
    lengths = np.linalg.norm(np.ascontiguousarray(rows), axis=1, keepdims=True)
    return np.asarray(rows / np.maximum(lengths, 1e-12), dtype=np.float32)
