"""Local coordinates of the poses that robots share, and the bytes of a quadratic function of them.

Far poses move by metres where a heading changes by a thousandth; what a robot says of them in absolute coordinates is
the small difference of large numbers. So each pose moves by what the one before carries it along, and by its own part.
The first of a part that hangs together may be anywhere, as long as nothing pulls at it: what is said of it is next to
nothing, and stands apart.
"""

from __future__ import annotations

from collections.abc import Set

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from ...errors import BackendError
from ...geometry import Array, skew
from ..compact import CompactReader, CompactWriter
from ..places import RIGID, SCALED, Places

# A rounded factor may change what the function says in any direction by these factors.
_LEAST, _MOST = 0.8, 1.25
_BYTE, _HALF, _SINGLE = 0, 1, 2
_LARGEST = 127.0
_TYPES = {_BYTE: "<i1", _HALF: "<f2", _SINGLE: "<f4"}


class LocalCoordinates:
    """``moves = T local``: moves ``(k w,)`` of poses from local ones; ``kept`` ``(k w,)``: numbers that mean anything;
    ``carried`` ``(n,)``, of those kept: not of the first pose of a part that nothing holds."""

    def __init__(
        self,
        places: Places,
        label: NDArray[np.intp],
        width: int,
        fixed: NDArray[np.bool_],
        grounded: Set[int] = frozenset(),
    ) -> None:
        """``places`` of the k poses, ``label`` ``(k,)`` of the part that each hangs together with; ``fixed`` ``(k,)``:
        those whose unit is no variable; ``grounded``: parts that priors hold."""
        k = len(label)
        first = np.zeros(k, dtype=bool)
        first[np.unique(label, return_index=True)[1]] = True
        first &= ~np.isin(label, sorted(grounded))
        free, carried = np.ones((2, k, width), dtype=bool)
        carried[first] = False
        if width == SCALED:
            free[fixed, RIGID] = False
        self.kept = free.ravel()
        self.carried = carried.ravel()[self.kept]
        self._T = _carried(places, label, width, fixed)

    def local(self, hessian: Array, b: Array) -> tuple[Array, Array]:
        """A quadratic function's matrix ``(k w, k w)`` and right-hand side ``(k w,)``, as the numbers kept see it."""
        T = self._T[:, self.kept]
        return T.T @ hessian @ T, T.T @ b

    def matrix(self, local: Array) -> Array:
        """Inverse of :meth:`local` for the matrix."""
        whole = np.zeros_like(self._T)
        whole[np.ix_(self.kept, self.kept)] = local
        half = solve_triangular(self._T, whole, lower=True, trans="T")
        return np.asarray(solve_triangular(self._T, half.T, lower=True, trans="T"))

    def vector(self, local: Array) -> Array:
        """Inverse of :meth:`local` for the right-hand side."""
        whole = np.zeros(len(self._T))
        whole[self.kept] = local
        return np.asarray(solve_triangular(self._T, whole, lower=True, trans="T"))


def _carried(places: Places, label: NDArray[np.intp], width: int, fixed: NDArray[np.bool_]) -> Array:
    """``(k w, k w)``, lower triangular: how a pose moves that others before it carry along rigidly."""
    k = len(label)
    R, t = places.poses[:, :3, :3], places.poses[:, :3, 3]
    out = np.zeros((k, width, k, width))
    for j in range(k):
        before = np.flatnonzero(label[: j + 1] == label[j])
        turn = R[before]
        out[j, :3, before, :3] = np.eye(3)
        out[j, :3, before, 3:6] = -skew(t[j] - t[before]) @ turn
        out[j, 3:6, before, 3:6] = R[j].T @ turn
        if width == SCALED:
            both = before[~fixed[before]] if not fixed[j] else before[:0]
            out[j, :3, both, 6] = t[j] - t[both]
            out[j, 6, both, 6] = 1.0
            out[j, 6, j, 6] = 1.0
    return out.reshape(k * width, k * width)


def write_function(out: CompactWriter, hessian: Array, carried: NDArray[np.bool_]) -> None:
    """A symmetric matrix ``(n, n)``, positive on the numbers ``carried`` ``(n,)``: its factor there in bytes or in half
    precision where that says the same, else in single; the rest in single.
    """
    inner = hessian[np.ix_(carried, carried)]
    size = np.sqrt(np.maximum(np.diagonal(inner), 0.0))
    size = np.where(size > 0, size, 1.0).astype(np.float32).astype(np.float64)
    scaled = inner / np.outer(size, size)
    kind, numbers = _rounded_factor(scaled)
    out.count(kind)
    out.array(size, "<f4")
    out.array(numbers, _TYPES[kind])
    out.array(hessian[np.ix_(~carried, carried)], "<f4")
    out.array(hessian[np.ix_(~carried, ~carried)][np.tril_indices(int((~carried).sum()))], "<f4")


def read_function(source: CompactReader, carried: NDArray[np.bool_]) -> Array:
    """Inverse of :func:`write_function`."""
    n, first = int(carried.sum()), int((~carried).sum())
    kind = source.count()
    if kind not in _TYPES:
        raise BackendError(f"a function is written as none is: {kind}")
    size = source.array(n, "<f4")
    lower = _lower(source.array(n * (n + 1) // 2, _TYPES[kind]), n)
    if kind == _BYTE:
        lower = lower / _LARGEST
    inner = lower + np.tril(lower, -1).T if kind == _SINGLE else lower @ lower.T
    across = source.array(first * n, "<f4").reshape(first, n)
    rest = _lower(source.array(first * (first + 1) // 2, "<f4"), first)
    out = np.zeros((len(carried), len(carried)))
    out[np.ix_(carried, carried)] = inner * np.outer(size, size)
    out[np.ix_(~carried, carried)] = across
    out[np.ix_(carried, ~carried)] = across.T
    out[np.ix_(~carried, ~carried)] = rest + np.tril(rest, -1).T
    return out


def _lower(numbers: Array, n: int) -> Array:
    out = np.zeros((n, n))
    out[np.tril_indices(n)] = numbers
    return out


def _rounded_factor(scaled: Array) -> tuple[int, Array]:
    """The numbers to send, and what they are: the coarsest that say the same in every direction."""
    rows = np.tril_indices(len(scaled))
    try:
        exact = cholesky(scaled, lower=True)[rows] if len(scaled) else np.zeros(0)
    except np.linalg.LinAlgError:
        return _SINGLE, scaled[rows]
    whole = np.rint(exact * _LARGEST)
    for kind, numbers, meant in (
        (_BYTE, whole, whole / _LARGEST),
        (_HALF, exact, np.asarray(exact.astype(np.float16), np.float64)),
    ):
        if _says_the_same(exact, meant, len(scaled)):
            return kind, numbers
    return _SINGLE, scaled[rows]


def _says_the_same(exact: Array, rounded: Array, n: int) -> bool:
    if not n:
        return True
    spread = np.linalg.svd(solve_triangular(_lower(exact, n), _lower(rounded, n), lower=True), compute_uv=False)
    return bool(spread[-1] ** 2 >= _LEAST and spread[0] ** 2 <= _MOST)
