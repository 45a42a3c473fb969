"""Everything that solver nodes say to each other: plain values with a sender and a receiver.

A transport may encode them as it likes; ``payload_bytes`` is what the published tables count (8 bytes a number of a separator pose).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from backend.geometry import Array


class Stage(IntEnum):
    """What a sweep works on, in this order; the numbers a separator node costs each sweep stand in :data:`WIDTH`."""

    START = 0
    SCALE = 1
    ROTATION = 2
    POSE = 3
    COST = 4


WIDTH = {Stage.START: 6, Stage.SCALE: 1, Stage.ROTATION: 9, Stage.POSE: 6, Stage.COST: 0}


@dataclass(frozen=True, eq=False)
class Values:
    """One robot's separator values of one sweep, for one neighbour.

    ``values`` ``(k, width)``: one row for each of the sender's nodes that share an edge with the receiver, sorted by index, which
    both sides know; rotations row by row (9), poses as translation and rotation vector (6), a log scale (1 row of 1 for the robot).
    ``initialised`` False: the sender has no estimate yet and ``values`` has no rows.
    """

    sender: int
    receiver: int
    stage: Stage
    step: int
    sweep: int
    initialised: bool
    values: Array

    @property
    def payload_bytes(self) -> int:
        return 8 * int(self.values.size)


@dataclass(frozen=True)
class Report:
    """What a robot and those below it in the tree of members say after a sweep: up the tree.

    ``change``: largest change of any robot's values; ``waiting``: robots that have no estimate yet; ``fresh``: robots that got
    their first one in this sweep; ``metric``: robots with a metric scale; ``cost``: sum of the edges each robot owns.
    """

    sender: int
    receiver: int
    stage: Stage
    step: int
    sweep: int
    change: float
    waiting: int
    fresh: int
    metric: int
    cost: float

    @property
    def payload_bytes(self) -> int:
        return 16


@dataclass(frozen=True)
class Decision:
    """What follows for everyone: down the tree. The same at every member, so all end at the same sweep.

    ``go_on``: one more sweep of this stage, else the next stage; ``value``: the sum of the reports where it is needed (cost, metric).
    """

    sender: int
    receiver: int
    stage: Stage
    step: int
    sweep: int
    go_on: bool
    value: float

    @property
    def payload_bytes(self) -> int:
        return 9


Message = Values | Report | Decision
