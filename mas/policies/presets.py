"""Presets by name: complete settings to start from; policies by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from maslam._replaced import replaced
from maslam.backend.config import RelPoseConfig, SolverConfig
from maslam.extensions import ExtensionGroup, check_name

from ..config import ConsistencyConfig, MasConfig, MergeConfig, OptimisationConfig, PlacesConfig
from ..errors import MasError
from .autonomous import Autonomous
from .base import Policy
from .directory import Directory
from .foreign import PolicyLike, foreign_policy
from .predecessor import Predecessor
from .query_all import QueryAll

_PREDECESSOR = MasConfig(
    preset="predecessor",
    policy="clustered",
    places=PlacesConfig(
        code="float32x128",
        certainty="strict",
        features="words",
        gap_keyframes=0,
        gap_m=10.0,
        own_age_s=30.0,
        own_apart_keyframes=None,
        own_age_keyframes=None,
    ),
    relpose=RelPoseConfig(search_angle_deg=5.0, hypotheses=300, ratio=0.75, max_hamming=50, min_inliers=20),
    consistency=ConsistencyConfig(rule="earlier", min_support=2),
    optimisation=OptimisationConfig(
        period_keyframes=1,
        solver=SolverConfig(method="dgs", relaxation=1.0, start="warm", rotation_sweeps=20, pose_sweeps=20),
    ),
    merge=MergeConfig(enabled=False),
)

# What the two optimised systems share. Place vectors travel as the thesis counts them.
_OPTIMISED = MasConfig(
    preset="optimised",
    policy="logic",
    places=PlacesConfig(code="float32", certainty="strict", latest_frames=5),
    merge=MergeConfig(consistency_m=100.0, redundancy_m=5.0, accuracy_m=5.0),
)

PRESETS: dict[str, MasConfig] = {
    "predecessor": _PREDECESSOR,
    "default": MasConfig(
        preset="default",
        places=PlacesConfig(code="float32", certainty="strict"),
        merge=MergeConfig(closing_rounds=0),
    ),
    "optimised": _OPTIMISED,
    "selection": replaced(_OPTIMISED, preset="selection", policy="selection"),
    "maslam": MasConfig(
        preset="maslam",
        policy="directory",
        places=PlacesConfig(
            code="int4",
            certainty="strict",
            widen_keyframes=50,
            gap_keyframes=6,
            gap_most_keyframes=12,
            closing_ends=True,
            gap_least_keyframes=3,
            max_points=400,
            first_points=110,
            point_code="grid",
            descriptor_bytes=16,
        ),
        optimisation=OptimisationConfig(
            period_keyframes=40,
            match_sigma_depth=0.003,
            solver=SolverConfig(method="elected", start="warm", length_sigma=0.01, update_tolerance=1e-3),
        ),
        merge=MergeConfig(
            form="compact", period_keyframes=40, max_points=32, consistency_m=2.0, accuracy_m=5.0, accuracy_share=0.5
        ),
    ),
}
"""The thesis's four systems, and ours.

``predecessor`` (4.1): clusters with owners, automatic optimisation, no maps. ``default`` (4.2): query all, no logic, no
purchases once all have stopped. ``optimised`` (4.3): Algorithms 2 and 3, latest five frames, final purchases.
``selection`` (4.4): the same with Algorithm 4. ``maslam``: the default of the command: each key-frame is
sent once, to one agent that keeps the place vectors of all, in half a byte a number; only pairs within the strict
distance are verified, from 110 points of 20 bytes on, and more where those promise a match; one elected agent solves
for the group; maps are compact, bought seldom, laid on place matches or rejected.

Distances below which places match belong to a network: all presets use the model's calibrated strict one, not the
thesis's 0.02 or the predecessor's 0.1. Those were strict, too: with the looser candidate distance 20 agents on KITTI
00's way verify 15 times as many pairs and send 35 times as many bytes for it, and find no more matches.
"""


def preset(name: str) -> MasConfig:
    """The settings of a preset."""
    if name not in PRESETS:
        raise MasError(f"there is no preset {name!r}; there are {', '.join(sorted(PRESETS))}")
    return PRESETS[name]


POLICIES: dict[str, Callable[[MasConfig, int], Policy]] = {
    "query_all": lambda config, me: QueryAll(),
    "clustered": lambda config, me: Predecessor(),
    "logic": lambda config, me: Autonomous(),
    "selection": lambda config, me: Autonomous(np.random.default_rng([config.seed, me])),
    "directory": lambda config, me: Directory(),
}


def check_policy(name: str) -> None:
    """Refuse a name that is none of ours and no entry point's."""
    check_name(ExtensionGroup.POLICIES, "policy", name, POLICIES)


def policy_of(config: MasConfig, me: int, given: PolicyLike | None = None) -> Policy:
    """A new policy for agent ``me``, with a generator of its own where it draws: ``given``, or by the name set."""
    if config.preset not in PRESETS:
        raise MasError(f"there is no preset {config.preset!r}; there are {', '.join(sorted(PRESETS))}")
    if given is not None:
        return foreign_policy(given)
    if config.policy in POLICIES:
        return POLICIES[config.policy](config, me)
    check_policy(config.policy)
    return foreign_policy(config.policy)
