"""Presets by name: complete settings to start from."""

from __future__ import annotations

from mas.config import MasConfig, MergeConfig, PlacesConfig
from mas.errors import MasError
from mas.policy.base import Policy
from mas.policy.query_all import QueryAll

PRESETS: dict[str, MasConfig] = {
    "default": MasConfig(preset="default", places=PlacesConfig(code="float32")),
    "maslam": MasConfig(
        preset="maslam",
        ask_again=False,
        places=PlacesConfig(max_points=600, first_points=200, point_code="grid", descriptor_bytes=16),
        merge=MergeConfig(period_keyframes=40, max_points=100),
    ),
}
"""``default``: the thesis's default system (4.2). ``maslam``: ours, the default of the command: does not ask where
the answer could not be used, buys maps less often while driving and with the points that a key-frame needs to be
recognised, and sends place vectors as int8, a byte a number. A verification begins with 200 points of 20 bytes, and
sends more where those promise a match.
"""


def preset(name: str) -> MasConfig:
    """The settings of a preset."""
    if name not in PRESETS:
        raise MasError(f"there is no preset {name!r}; there are {', '.join(sorted(PRESETS))}")
    return PRESETS[name]


def policy_of(config: MasConfig) -> Policy:
    """A new policy for one agent."""
    if config.preset not in PRESETS:
        raise MasError(f"there is no preset {config.preset!r}; there are {', '.join(sorted(PRESETS))}")
    return QueryAll()
