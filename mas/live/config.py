"""Settings of an agent as a process of its own."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from maslam._settings import Settings

from ..config import LinkConfig
from .topics import LiveTopic

LINKS: dict[str, LinkConfig] = {
    "cable": LinkConfig(repeat_s=0.2, repeat_max_s=3.0, silence_s=5.0),
    "wifi": LinkConfig(repeat_s=0.5, repeat_max_s=5.0, silence_s=10.0),
    "radio": LinkConfig(repeat_s=2.0, repeat_max_s=16.0, silence_s=45.0),
}
"""How long to wait for answers, by kind of link; round trips are measured besides."""


class LiveConfig(Settings):
    """One agent on a real network, in its own time."""

    link: Literal["cable", "wifi", "radio"] = Field(
        default="cable", description="kind of network: how long to wait for answers before they are asked for again"
    )
    speed: float = Field(
        default=1.0, gt=0, le=1000, description="key-frames come so many times as fast as they were recorded"
    )
    settle_s: float = Field(
        default=2.0, ge=0, description="nobody has anything left to do for so long: the agent ends, seconds"
    )
    publish: frozenset[LiveTopic] = Field(
        default=frozenset(), description="topics of a live agent that are given out while somebody listens: pose, map"
    )
    map_each_s: float = Field(
        default=10.0, gt=0, description="a map that has changed is given out so long after the one before, seconds"
    )
    alone_s: float = Field(
        default=30.0, ge=0, description="so long an agent waits for a first neighbour before it ends alone, seconds"
    )
