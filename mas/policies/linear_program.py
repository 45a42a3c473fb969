"""Agent logic (thesis section 3.9.1, Algorithms 2 and 3): how many agents to optimise with, to buy maps from and to
ask for places, as the least of a linear cost under two constraints."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..errors import MasError

_TOLERANCE = 1e-9
# SLSQP ends a hair beside a whole number: that much is added before rounding down.
_WHOLE = 1e-6


@dataclass(frozen=True)
class Situation:
    """Input of Algorithm 2. ``agents``: all in the system, this one included; ``group``: other agents it is
    grouped with; ``matches_grew``, ``group_grew``: since its last decision."""

    agents: int
    group: int
    matches_grew: bool
    group_grew: bool

    def __post_init__(self) -> None:
        if self.agents < 1 or self.group < 0:
            raise MasError(f"no situation of an agent: {self.agents} agents, {self.group} of them in its group")


@dataclass(frozen=True)
class Numbers:
    """The decision. ``optimise``: agents that optimise together, this one included; ``merge``: agents to buy maps
    from; ``ask``: agents to ask for a place."""

    optimise: int
    merge: int
    ask: int


@dataclass(frozen=True, eq=False)
class Programme:
    """The linear programme: least ``weights @ x`` with ``0 <= x <= upper``, ``sum(x) >= minimum`` and ``x[0] >= x[1]``;
    ``x`` = the three numbers, all arrays ``(3,)``."""

    weights: NDArray[np.float64]
    upper: NDArray[np.float64]
    minimum: float


def programme(situation: Situation) -> Programme:
    """Algorithms 2 and 3 as the text means them.

    Line 2 of Algorithm 3 contradicts the text of 3.9.1: places gained give the bound ``2 * group``. The other
    branch is printed ``agents + group - 4``; "a quarter of the group size" is meant, where the upper bounds allow it,
    else as much as they allow (a group of 0: one less). The upper bound of places, ``agents - 2``, would forbid two
    agents to ever ask each other: it is 1 where there is another agent at all.
    """
    s = situation
    gained, grown = (1.0 if flag else -1.0 for flag in (s.matches_grew, s.group_grew))
    weights = np.array([-gained - math.sqrt(s.group + 1), -gained - grown, gained])
    upper = np.array([s.group + 1, s.group, max(s.agents - 2, min(s.agents - 1, 1))], dtype=np.float64)
    minimum = 2.0 * s.group if s.matches_grew else s.agents + s.group / 4.0
    return Programme(weights, upper, min(minimum, float(upper.sum())))


def solve(problem: Programme) -> NDArray[np.float64]:
    """The optimum ``(3,)`` by SLSQP from the middle of the bounds (Algorithm 2); an error where it does not get
    there."""
    # Imported here: scipy.optimize takes longer to load than most commands that never decide anything.
    from scipy.optimize import minimize

    # SLSQP stops by the change of the cost: in shares of the upper bounds all numbers, costs and steps are about 1.
    unit = np.maximum(problem.upper, 1.0)
    size = float(unit.max())
    weights = problem.weights * unit / size
    found = minimize(
        lambda x: float(weights @ x),
        0.5 * problem.upper / unit,
        jac=lambda x: weights,
        bounds=[(0.0, float(u)) for u in problem.upper / unit],
        constraints=[
            {"type": "ineq", "fun": lambda x: (unit @ x - problem.minimum) / size, "jac": lambda x: unit / size},
            {
                "type": "ineq",
                "fun": lambda x: (unit[0] * x[0] - unit[1] * x[1]) / size,
                "jac": lambda x: np.array([unit[0], -unit[1], 0.0]) / size,
            },
        ],
        method="SLSQP",
        options={"ftol": _TOLERANCE, "maxiter": 200},
    )
    if not found.success:
        raise MasError(f"agent logic: SLSQP did not converge after {found.nit} iterations: {found.message}")
    return np.asarray(found.x * unit, dtype=np.float64)


@lru_cache(maxsize=4096)
def decide(situation: Situation) -> Numbers:
    """The three numbers: rounded down, and no more than there are agents."""
    x = np.floor(solve(programme(situation)) + _WHOLE).astype(int)
    others = situation.agents - 1
    optimise, merge, ask = (int(v) for v in np.clip(x, 0, [others + 1, others, others]))
    return Numbers(optimise, merge, ask)
