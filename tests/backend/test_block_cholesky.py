"""Large systems are solved by a Cholesky factor in blocks: against dense algebra, and against the LU factor."""

import numpy as np
import pytest
from graphs import grid

from maslam.backend.central import large_system, linear
from maslam.backend.central.block_cholesky import BlockMatrix
from maslam.backend.central.costs import cost
from maslam.backend.central.linear import BlockSystem
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig
from maslam.backend.errors import BackendError


def random_blocks(rng, nodes, edges, width):
    """Edges, some parallel, some backwards, some to a given node (-1), and blocks that hold every node."""
    ends = np.concatenate([rng.integers(0, nodes, (edges, 2)), [(k, -1) for k in range(0, nodes, 3)]])
    ends = np.concatenate([ends[ends[:, 0] != ends[:, 1]], [(k + 1, k) for k in range(nodes - 1)]])
    half = rng.normal(size=(len(ends), 2 * width, 2 * width))
    return ends, half @ np.swapaxes(half, 1, 2)


def dense(ends, hessian, nodes, width):
    out = np.zeros((nodes * width, nodes * width))
    for pair, block in zip(ends, hessian, strict=True):
        for a, i in enumerate(pair):
            for b, j in enumerate(pair):
                if i >= 0 and j >= 0:
                    part = block[a * width : (a + 1) * width, b * width : (b + 1) * width]
                    out[i * width : (i + 1) * width, j * width : (j + 1) * width] += part
    return out


@pytest.mark.parametrize("width", [3, 6])
@pytest.mark.parametrize("seed", range(4))
def test_it_solves_what_dense_algebra_solves(width, seed):
    rng = np.random.default_rng(seed)
    ends, hessian = random_blocks(rng, 30, 60, width)
    matrix = BlockMatrix(ends, 30, width)
    for at in range(0, len(ends), 7):
        matrix.add(at, hessian[at : at + 7])
    rhs = rng.normal(size=(30 * width, 2))
    expected = np.linalg.solve(dense(ends, hessian, 30, width), rhs)
    np.testing.assert_allclose(matrix.factor().solve(rhs), expected, rtol=1e-7, atol=1e-9)


def test_a_matrix_that_is_not_positive_is_refused():
    hessian = np.tile(np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3)), (3, 1, 1))
    matrix = BlockMatrix(np.array([(0, 1), (1, 2), (2, 3)]), 4, 3)
    matrix.add(0, -hessian)
    with pytest.raises(BackendError, match="12 equations is not positive definite"):
        matrix.factor()


@pytest.mark.parametrize("seed", range(2))
def test_the_optimum_is_the_same_whatever_factor_finds_it(seed, monkeypatch):
    graph, _ = grid(np.random.default_rng(seed), sigma=0.15)
    expected = optimise(graph, CentralConfig())
    monkeypatch.setattr(linear, "LARGE", 0)
    monkeypatch.setattr(large_system, "LARGE", 0)
    monkeypatch.setattr(large_system, "_EDGES", 10)
    monkeypatch.setattr(BlockSystem, "_lu_factor", None)
    found = optimise(graph, CentralConfig())
    assert found.cost_after == pytest.approx(expected.cost_after, rel=1e-10)
    assert cost(found.graph, "F") == pytest.approx(expected.cost_after, rel=1e-10)
    for n, T in expected.graph.poses.items():
        np.testing.assert_allclose(found.graph.poses[n], T, atol=1e-6)
