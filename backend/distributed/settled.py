"""What is left of a whole solution for updates to go on from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .condense import Known
from .contribution import Contribution


@dataclass(frozen=True, eq=False)
class Settled:
    """End of a whole solution: the elected robot, at itself what all contributed, and the places that the robot (the
    elected one: every robot) has read."""

    leader: int
    places: Known
    contributions: Mapping[int, Contribution]
