"""What a robot ends with."""

from __future__ import annotations

import numpy as np

from ...geometry import Array
from ..compact import poses_of
from ..places import Places
from ..share import Share, SolverOutcome
from .passes import Passes
from .reports import Step


def finished(share: Share, passes: Passes, step: Step, count: int) -> SolverOutcome:
    """What a robot ends with, after ``count`` passes."""
    front = passes.front
    own = front.nodes[: front.own_count]
    start = front.places(share).at(slice(front.own_count))
    accepted = step.cost <= step.cost_before
    reason = "accepted" if accepted else f"the cost would rise: {step.cost_before:.6g} to {step.cost:.6g}"
    places, reached = passes.places.at(slice(front.own_count)), front.reached[: front.own_count]
    if step.origin is not None:
        places = _carried(places, step.origin)
    final = start
    if accepted:
        final.put(reached, places.at(reached))
    return SolverOutcome(
        robot=share.robot,
        accepted=accepted,
        reason=reason,
        poses={n: final.poses[k].copy() for k, n in enumerate(own)},
        units=dict(zip(own, np.exp(final.log_units).tolist(), strict=True)),
        cost_before=step.cost_before,
        cost_after=step.cost if accepted else step.cost_before,
        rotation_sweeps=0,
        pose_sweeps=count,
        capped=step.capped,
        unreached=tuple(n for n, r in zip(own, reached.tolist(), strict=True) if not r),
    )


def refused(share: Share, megabytes: float, most: float) -> SolverOutcome:
    """Poses as they were: too many ``megabytes`` would have to be sent, more than ``most``."""
    own = sorted(share.poses)
    return SolverOutcome(
        robot=share.robot,
        accepted=False,
        reason=f"robots share so many poses that elimination may send {megabytes:.0f} MB and more each time "
        f"(solver.multifrontal_most_mb: {most:g}); methods two-level and elected send less there",
        poses={n: T.copy() for n, T in share.poses.items()},
        units=dict(zip(own, np.exp(share.log_units(own)).tolist(), strict=True)),
        cost_before=float("nan"),
        cost_after=float("nan"),
        rotation_sweeps=0,
        pose_sweeps=0,
        unreached=(),
    )


def _carried(places: Places, origin: Array) -> Places:
    """Places in the frame whose pose and log unit are ``origin`` ``(7,)``."""
    poses = places.poses.copy()
    poses[:, :3, 3] *= np.exp(origin[6])
    return Places(poses_of(origin[:6]) @ poses, places.log_units + origin[6])
