"""Whether an update can be believed: what right edges can raise the cost by, and a member's own edges. Pure."""

from __future__ import annotations

import numpy as np

from ...geometry import Array
from ...robust import chi_square

# One right edge in a million is further off.
_RIGHT = 1.0 - 1e-6
# A member's cost may differ from what the elected robot finds by this share beside rounding.
_SAME = 0.01
# An own edge whose residual has grown less than so many times is no worse off than before.
_GROWN = 2.0


def most_rise(cost: float, freedom: int, gained: int) -> float:
    """What edges with ``gained`` degrees of freedom can raise F by; edges so far may have more noise than stated, as
    ``cost`` and ``freedom`` show."""
    noise = max(1.0, cost / freedom) if freedom > 0 else 1.0
    right = chi_square.below(_RIGHT, gained) if gained > 0 else 0.0
    return noise * right + _SAME * cost


def contradicts(before: Array, after: Array, expected: float | None, off: float) -> str:
    """How a member's own edges, whose shares of F ``(m,)`` are ``before`` and ``after`` a correction, contradict it;
    empty where they do not.

    ``expected``: F over them as the elected robot finds it, None where it does not know all of them; ``off``: most
    deviations by which rounding displaces an edge there.
    """
    cost = float(after.sum())
    if not np.isfinite(cost if expected is None else cost + expected):
        return "a correction leaves own edges without a cost"
    if expected is not None:
        doubt = float((2.0 * np.sqrt(after) * off + off**2).sum())
        if abs(cost - expected) > doubt + _SAME * max(cost, expected):
            return f"own edges cost {cost:.4g} with a correction, not {expected:.4g}"
    most = max(chi_square.below(_RIGHT, 6), _GROWN * float(before.max(initial=0.0)))
    torn = float(after.max(initial=0.0))
    return f"a correction tears an own edge: {torn:.4g}, {most:.4g} at most" if torn > most else ""
