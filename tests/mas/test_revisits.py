"""Times from a key-frame's coming to its match and to poses that hold it, beside those that a test sets."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import cast

import pytest

from maslam.mas.agent import Agent
from maslam.mas.live.revisits import Revisits
from maslam.mas.protocol.ids import MatchId


@dataclass
class State:
    me: int = 1
    accepted: set[MatchId] = field(default_factory=set)
    keyframes: list[int] = field(default_factory=list)


@dataclass
class Known:
    """What the measurement looks at of an agent."""

    state: State = field(default_factory=State)
    held_matches: frozenset[MatchId] = frozenset()


@dataclass
class Clock:
    now: float = 0.0

    def __call__(self) -> float:
        return self.now


def test_times_are_those_between_a_key_frame_and_its_match() -> None:
    agent, clock = Known(), Clock()
    revisits = Revisits(cast(Agent, agent), clock)
    for index, came_s in enumerate((10.0, 11.0, 12.0)):
        revisits.came(index, came_s)
    clock.now = 13.0
    agent.state.keyframes = [0, 1]
    revisits.look()
    clock.now = 14.5
    mine, others, later = MatchId(1, 1, 0, 7), MatchId(0, 2, 1, 0), MatchId(1, 0, 1, 2)
    agent.state.accepted = {mine, others}
    revisits.look()
    assert revisits.times().uncorrected == 1 and revisits.times().corrected_mean_s == 0.0
    clock.now = 15.0
    agent.state.accepted |= {later}
    agent.held_matches = frozenset({mine, others})
    revisits.look()
    clock.now = 20.0
    agent.held_matches = frozenset({mine, others, later})
    revisits.look()
    clock.now = 30.0
    revisits.look()
    times = revisits.times()
    # Of key-frame 1: acted on after 2 s, accepted after 3.5, corrected after 4; of key-frame 0: 3, 5 and 10.
    assert (times.revisits, times.uncorrected) == (2, 0)
    assert times.passed_on_mean_s == pytest.approx((2 + 3) / 2)
    assert times.accepted_mean_s == pytest.approx((3.5 + 5) / 2)
    assert times.corrected_mean_s == pytest.approx((4 + 10) / 2) and times.corrected_most_s == pytest.approx(10)


def test_matches_of_an_earlier_process_are_not_measured() -> None:
    old, gone = MatchId(1, 0, 0, 0), MatchId(1, 1, 0, 1)
    agent, clock = Known(State(accepted={old}, keyframes=[0, 1])), Clock(5.0)
    revisits = Revisits(cast(Agent, agent), clock)
    revisits.look()
    agent.state.accepted.add(gone)  # of a key-frame that came before this process
    revisits.look()
    assert revisits.times().revisits == 0
