"""Whether a pose is that of something that came into view, moves, and carries the camera along: most of what was known
is hidden, and the camera cannot have moved so.

What comes before a moving camera may hold most points of the image, and a turn of the camera makes up for what far
points contradict: the points alone do not tell. A bound on the acceleration does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3_inverse

from ..reason import NO_REASON, Reason

Array = NDArray[np.float64]
_PROVEN = 2
"""Key-frames, or poses since the last one, with which a point has to agree until it is known not to move."""
_MOST = 0.75
"""Share of the points known not to move, of those in view, which bear out any motion where they agree with it."""
_ACCELERATION = 6.0
"""Acceleration, m/s^2, up to which no more is asked: more than wheels have, and three times that of a walk."""
_HASTE_S = 0.1
"""A hand that holds a camera jerks for so long: of frames that come faster the velocity may change as much."""
_TIMES, _LATEST, _FEWEST = 3.0, 20, 5
"""Times the median acceleration of so many frames, up to which no more is asked either; fewer frames tell nothing."""
_DEPTH_SHARE = 0.005
"""Share of the median depth of its points that a step may be wrong by."""
_RETURNED, _RETURNED_SHARE = 100, 0.25
"""Points, or share of those expected in view, with which a view that was lost is back."""
CARRIED = "something that moves hides the view"


@dataclass(frozen=True)
class PossibleStep:
    """How far ``beyond`` the motion so far a camera's step ends, and how far it may at most (``bound``); in ``unit``.
    What is known of no motion before is possible."""

    beyond: float
    bound: float
    unit: str

    @property
    def possible(self) -> bool:
        """Whether a camera can make it."""
        return self.beyond <= self.bound

    @property
    def refusal(self) -> Reason:
        """Why there is no pose."""
        text = (
            f"points agree on a step {self.beyond:.3g} beyond the camera's motion, bound {self.bound:.3g} {self.unit}"
        )
        return Reason(CARRIED, f"{CARRIED}: {text}", self.bound / max(self.beyond, 1e-12))


@dataclass(frozen=True)
class MotionSoFar:
    """``T_C1_C0`` of the last step, ``step_s`` its duration (0: unknown), and the latest ``accelerations``, in the
    track's unit per s^2; it is ``metric`` where that is the metre."""

    metric: bool
    T_C1_C0: Array | None = None
    step_s: float = 0.0
    accelerations: tuple[float, ...] = ()

    def step(self, T_C0_W: Array, T_C_W: Array, dt: float, depth: float) -> PossibleStep:
        """The step of ``dt`` seconds from ``T_C0_W`` to ``T_C_W``, by points of that median depth."""
        unit = "m" if self.metric else "(unit of the track)"
        return PossibleStep(self._beyond(T_C0_W, T_C_W, dt) or 0.0, self._bound(dt, depth), unit)

    def after(self, T_C0_W: Array, T_C_W: Array, dt: float) -> MotionSoFar:
        """With that step."""
        if not dt > 0.0:
            return self
        beyond, known = self._beyond(T_C0_W, T_C_W, dt), self.accelerations
        if beyond is not None:
            known = (*known[1 - _LATEST :], beyond / self._lever_s2(dt))
        return MotionSoFar(self.metric, product(T_C_W, se3_inverse(T_C0_W)), dt, known)

    def _beyond(self, T_C0_W: Array, T_C_W: Array, dt: float) -> float | None:
        """Distance of the camera ``T_C_W`` from where it would have gone at the same velocity; None without one."""
        if self.T_C1_C0 is None or self.step_s <= 0.0:
            return None
        before, last, now = (_centre(T) for T in (product(se3_inverse(self.T_C1_C0), T_C0_W), T_C0_W, T_C_W))
        return float(np.linalg.norm(now - last - (last - before) * dt / self.step_s))

    def _bound(self, dt: float, depth: float) -> float:
        known, lever_s2 = len(self.accelerations) >= _FEWEST, self._lever_s2(dt)
        usual = _TIMES * float(np.median(self.accelerations)) if known else 0.0
        if not self.metric:
            return usual * lever_s2 + _DEPTH_SHARE * depth if known else np.inf
        # What is usual beyond gravity is noise of the poses, which does not grow with time.
        noise = usual * min(lever_s2, dt**2, self.step_s**2)
        return max(noise, _ACCELERATION * max(lever_s2, dt * _HASTE_S)) + _DEPTH_SHARE * depth

    def _lever_s2(self, dt: float) -> float:
        return dt * (dt + self.step_s) / 2.0


def proven(views: NDArray[np.int64], agreed: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Points ``(n,)`` known not to move: seen by ``views`` key-frames, or ``agreed`` with so many poses since."""
    return np.asarray((views >= _PROVEN) | (agreed >= _PROVEN))


def borne_out(inlier: NDArray[np.bool_], expected: NDArray[np.bool_]) -> bool:
    """Whether most of the points ``expected`` in view, which are known not to move, agree with a pose."""
    return bool(expected.any()) and int((inlier & expected).sum()) >= _MOST * int(expected.sum())


def hidden_still(agree: int, expected: int) -> Reason:
    """Why a view that was lost is not back although ``agree`` points of those ``expected`` are seen: a camera found
    by what is left beside a thing that hides the rest would take that into its map. :data:`NO_REASON` where it is."""
    need = int(np.ceil(min(_RETURNED, _RETURNED_SHARE * expected)))
    if agree >= need:
        return NO_REASON
    return Reason.few("most of the view is still hidden", agree, need, f"of {expected} points found again")


def doubt_carried(inliers: int, found: int) -> Reason:
    """Why a pose may be wrong that a part of the points ``found`` gave against the others."""
    text = f"{inliers} of {found} points agree with the camera's motion, others with one that it cannot have"
    return Reason(CARRIED, text, found / max(inliers, 1))


def _centre(T_C_W: Array) -> Array:
    return np.asarray(-T_C_W[:3, :3].T @ T_C_W[:3, 3])
