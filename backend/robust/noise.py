"""Ratio of the true noise to the one that the edges state, and in how many directions.

Public graphs, and simple front ends, state far too small uncertainties; a chi-square threshold then throws away most
of what is right. The law of right edges' squared distances is found with the selection itself: from what is believed
so far comes a wider law, which lets more be believed, until both agree. Gaussian residuals stop that growth at their
true law; it never becomes narrower than the stated one, and wrong edges are too few among the near ones to feed it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..config import RobustConfig
from ..geometry import Array
from . import chi_square

# With fewer residual degrees of freedom than this, the residuals say nothing.
_ENOUGH = 12
# Distances from which quartiles tell the shape of their law.
_ENOUGH_FOR_SHAPE = 30
# The law has settled when its mean grows by less than this share.
_SETTLED = 0.02


def degrees_of_freedom(dimension: int) -> int:
    """Of one relative pose: 6, or 3 in the plane."""
    return 6 if dimension == 3 else 3


@dataclass(frozen=True)
class Noise:
    """Squared distances of right edges, in stated standard deviations, are ``scale`` times chi-square of ``freedom``
    degrees: scale 1 and the ``full`` freedom where the edges state the
    truth; a few degrees where only some directions, a heading say, are noisier than stated.
    """

    full: int
    scale: float
    freedom: float

    @classmethod
    def stated(cls, dimension: int) -> Noise:
        """The noise as the edges state it: scale 1, full degrees of freedom."""
        full = degrees_of_freedom(dimension)
        return cls(full, 1.0, float(full))

    @property
    def factor(self) -> float:
        """Factor by which standard deviations exceed the stated ones, in the mean over directions."""
        return (self.scale * self.freedom / self.full) ** 0.5

    def limit(self, exceeding: float) -> float:
        """The squared distance that a right edge exceeds with this probability."""
        return self.scale * chi_square.exceeded(exceeding, self.freedom)

    def fitted(self, squared: Array, config: RobustConfig) -> Noise:
        """After a look at the squared distances ``(k,)`` of what is believed now; the same where it has settled.

        By median and upper quartile, which a quarter of wrong ones among them does not move far.
        """
        if not len(squared):
            return self
        from scipy.optimize import brentq  # a tenth of a second to import

        middle, upper = np.quantile(squared, [0.5, 0.75])
        freedom = float(self.full)
        if len(squared) >= _ENOUGH_FOR_SHAPE and upper > middle * _spread(freedom):
            wanted = min(upper / max(middle, 1e-12), _spread(1.0))
            freedom = float(brentq(lambda h: _spread(h) - wanted, 1.0, freedom)) if wanted < _spread(1.0) else 1.0
        scale = float(middle / chi_square.below(0.5, freedom))
        return self._wider(scale, freedom, self.full * len(squared), config)

    def grown(self, mean: float, freedom: int, config: RobustConfig) -> Noise:
        """The same law, as wide as a ``mean`` of squared distances that have ``freedom`` degrees together says."""
        return self._wider(mean / self.freedom, self.freedom, freedom, config)

    def _wider(self, scale: float, freedom: float, evidence: int, config: RobustConfig) -> Noise:
        scale = min(scale, self.full * config.max_noise**2 / freedom)
        settled = scale * freedom <= self.scale * self.freedom * (1.0 + _SETTLED)
        if config.noise == "stated" or evidence < _ENOUGH or settled:
            return self
        return Noise(self.full, scale, freedom)


def _spread(freedom: float) -> float:
    """Upper quartile of chi-square over its median: 1.5 for six degrees, 2.9 for one."""
    return chi_square.below(0.75, freedom) / chi_square.below(0.5, freedom)
