"""Algorithms 2 and 3 against an exact solver of linear programmes, for every situation of up to 50 agents."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from scipy.optimize import OptimizeResult, linprog
from scipy.sparse import block_diag

from maslam.mas.errors import MasError
from maslam.mas.policies import linear_program
from maslam.mas.policies.linear_program import Numbers, Programme, Situation, decide, programme, solve

FLAGS = tuple(product((-1, 1), repeat=2))


def exact_optima(agents: int) -> dict[tuple[int, int, int], float]:
    """The least cost for each group size and both flags, from the text of thesis section 3.9.1 as settled: all of them
    side by side in one programme, by HiGHS."""
    ask = {1: 0, 2: 1}.get(agents, agents - 2)
    situations = [(group, pm, growth) for group in range(agents + 1) for pm, growth in FLAGS]
    costs, limits, bounds = [], [], []
    for group, pm, growth in situations:
        least = 2 * group if pm == 1 else agents + group / 4
        costs += [-pm - math.sqrt(group + 1), -pm - growth, pm]
        limits += [-min(least, 2 * group + 1 + ask), 0.0]
        bounds += [(0, group + 1), (0, group), (0, ask)]
    rows = block_diag([[[-1, -1, -1], [-1, 1, 0]]] * len(situations), format="csr")
    found = linprog(costs, A_ub=rows, b_ub=limits, bounds=bounds, method="highs")
    assert found.status == 0
    each = (np.array(costs) * found.x).reshape(-1, 3).sum(axis=1)
    return dict(zip(situations, each.tolist(), strict=True))


@pytest.mark.parametrize("agents", range(1, 51))
def test_slsqp_reaches_the_optimum_in_every_situation(agents: int) -> None:
    for (group, pm, growth), least in exact_optima(agents).items():
        problem = programme(Situation(agents, group, pm == 1, growth == 1))
        x = solve(problem)
        where = f"group of {group}, {pm}, {growth}: {x}"
        assert float(problem.weights @ x) == pytest.approx(least, abs=1e-5), where
        assert (x >= -1e-7).all() and (x <= problem.upper + 1e-7).all(), where
        assert x.sum() >= problem.minimum - 1e-6 and x[0] >= x[1] - 1e-6, where


def test_gaining_places_leads_to_optimising_and_merging_and_to_no_questions() -> None:
    assert decide(Situation(10, 5, True, True)) == Numbers(6, 5, 0)


@pytest.mark.parametrize("group", range(10))
def test_gaining_none_leads_to_as_many_questions_as_are_allowed(group: int) -> None:
    assert decide(Situation(10, group, False, False)).ask == 8


def test_an_agent_without_a_group_may_still_optimise_alone() -> None:
    assert decide(Situation(10, 0, False, False)) == Numbers(1, 0, 8)


def test_two_agents_ask_each_other_and_one_asks_nobody() -> None:
    assert decide(Situation(2, 0, False, False)).ask == 1
    assert decide(Situation(3, 0, False, False)).ask == 1
    assert decide(Situation(1, 0, False, False)).ask == 0


def test_numbers_are_whole_and_within_what_exists() -> None:
    for agents, group, (pm, growth) in product(range(1, 13), range(13), FLAGS):
        numbers = decide(Situation(agents, group, pm == 1, growth == 1))
        assert 0 <= numbers.optimise <= min(agents, group + 1)
        assert 0 <= numbers.merge <= min(agents - 1, group)
        assert 0 <= numbers.ask <= agents - 1


def test_a_solver_that_does_not_converge_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    import scipy.optimize

    stuck = OptimizeResult(success=False, nit=200, message="Iteration limit reached", x=np.zeros(3))
    monkeypatch.setattr(scipy.optimize, "minimize", lambda *args, **options: stuck)
    decide.cache_clear()
    with pytest.raises(MasError, match="did not converge after 200 iterations: Iteration limit"):
        decide(Situation(4, 1, True, False))


def test_an_infeasible_programme_is_an_error() -> None:
    with pytest.raises(MasError, match="SLSQP did not converge"):
        solve(Programme(np.array([-1.0, 0.0, 1.0]), np.array([2.0, 1.0, 2.0]), 9.0))


def test_a_situation_that_cannot_be_is_an_error() -> None:
    with pytest.raises(MasError, match="no situation of an agent: 0 agents"):
        linear_program.Situation(0, 0, False, False)
