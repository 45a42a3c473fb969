"""How much larger the noise is than the edges state: one factor for a whole graph.

Public graphs, and simple front ends, state far too small uncertainties; a chi-square threshold then throws away most
of what is right. The factor is found with the selection itself: from what is believed so far comes a larger factor,
which lets more be believed, until both agree. Gaussian residuals stop that growth at their true factor; it never
shrinks below 1, and wrong edges are too few among the near ones to feed it.
"""

from __future__ import annotations

from backend.config import RobustConfig

# The factor has settled when its square grows by less than this share.
SETTLED = 0.02
# With fewer residual degrees of freedom than this, the factor says nothing.
_ENOUGH = 12


def degrees_of_freedom(dimension: int) -> int:
    """Of one relative pose: 6, or 3 in the plane."""
    return 6 if dimension == 3 else 3


def grown(squared_noise: float, total: float, freedom: int, config: RobustConfig) -> float:
    """The squared factor after a look at what is believed now: ``total`` of squared distances in stated standard
    deviations, which are expected to have ``freedom`` degrees.
    """
    if config.noise == "stated" or freedom < _ENOUGH:
        return squared_noise
    return min(max(squared_noise, total / freedom), config.max_noise**2)
