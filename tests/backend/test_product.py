"""Products that are summed in one order: right, and the same for a row alone as among many."""

from __future__ import annotations

import numpy as np
import pytest

from maslam.backend.geometry import product


@pytest.mark.parametrize("terms", [0, 1, 3, 4, 7, 8, 12])
@pytest.mark.parametrize("columns", [None, 1, 3])
@pytest.mark.parametrize("rows", [1, 4, 17, 300])
def test_each_row_is_what_it_is_alone(terms: int, columns: int | None, rows: int) -> None:
    rng = np.random.default_rng(terms)
    a, b = rng.normal(size=(rows, terms)), rng.normal(size=(terms, columns) if columns else terms)
    made = product(a, b)
    assert made.shape == (a @ b).shape and made.flags.c_contiguous
    np.testing.assert_allclose(made, a @ b, atol=1e-14)
    alone = np.concatenate([product(a[i : i + 1], b) for i in range(rows)])
    assert made.tobytes() == alone.tobytes()


def test_of_many_matrices_each_is_taken() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(40, 4, 4)), rng.normal(size=(4, 4))
    for some, others in ((a, b), (b, a), (a, a[::-1])):
        np.testing.assert_allclose(product(some, others), some @ others, atol=1e-14)
