"""How much larger the noise is than the edges state, and in how many directions.

Public graphs, and simple front ends, state far too small uncertainties; a chi-square threshold then throws away most
of what is right. The law of right edges' squared distances is found with the selection itself: from what is believed
so far comes a wider law, which lets more be believed, until both agree. Gaussian residuals stop that growth at their
true law; it never becomes narrower than the stated one, and wrong edges are too few among the near ones to feed it.
"""

from __future__ import annotations

from dataclasses import dataclass

from scipy.stats import chi2

from backend.config import RobustConfig

# With fewer residual degrees of freedom than this, the residuals say nothing.
_ENOUGH = 12
# The law has settled when its mean grows by less than this share.
_SETTLED = 0.02


def degrees_of_freedom(dimension: int) -> int:
    """Of one relative pose: 6, or 3 in the plane."""
    return 6 if dimension == 3 else 3


@dataclass(frozen=True)
class Noise:
    """Squared distances of right edges, in stated standard deviations, are ``scale`` times chi-square of ``freedom``
    degrees (Satterthwaite's fit of mean and variance): scale 1 and the ``full`` freedom where the edges state the
    truth; a few degrees where only some directions, a heading say, are noisier than stated.
    """

    full: int
    scale: float
    freedom: float

    @classmethod
    def stated(cls, dimension: int) -> Noise:
        full = degrees_of_freedom(dimension)
        return cls(full, 1.0, float(full))

    @property
    def factor(self) -> float:
        """By how much standard deviations exceed the stated ones, in the mean over directions."""
        return (self.scale * self.freedom / self.full) ** 0.5

    def limit(self, exceeding: float) -> float:
        """The squared distance that a right edge exceeds with this probability."""
        return self.scale * float(chi2.isf(exceeding, self.freedom))

    def grown(self, mean: float, variance: float, freedom: int, config: RobustConfig) -> Noise:
        """After a look at what is believed now: mean and variance of squared distances that have ``freedom`` degrees
        together. The same where it has settled.
        """
        mean = min(mean, self.full * config.max_noise**2)
        if config.noise == "stated" or freedom < _ENOUGH or mean <= self.scale * self.freedom * (1.0 + _SETTLED):
            return self
        degrees = min(max(2.0 * mean**2 / max(variance, 1e-12), 1.0), float(self.full))
        return Noise(self.full, mean / degrees, degrees)
