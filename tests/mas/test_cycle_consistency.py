"""A group's matches against each other: who is contradicted, and that nobody honest is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from maslam.backend.geometry import Sim3, se3, se3_exp, so3_exp
from maslam.mas.optimisation.cycle_consistency import contradicted
from maslam.mas.optimisation.planning import End, Joint
from maslam.mas.protocol.ids import FrameId, MatchId

DEPTH = 10.0


@dataclass(frozen=True)
class Group:
    """Tracks of agents on one ground, each in its own coordinates and unit, with matches between them."""

    joints: dict[MatchId, Joint]
    depths: dict[tuple[int, int], float]


def group(seed: int, agents: int = 4, a_pair: int = 3, noise_m: float = 0.1) -> Group:
    rng = np.random.default_rng(seed)
    units = rng.uniform(0.3, 3.0, agents)
    frames = []
    for unit in units:
        pose = se3(so3_exp([0.0, rng.uniform(-3, 3), 0.0]), rng.uniform(-100, 100, 3))
        frames.append(Sim3(pose[:3, :3], pose[:3, 3], 1.0 / unit))  # T_W_F
    joints = {}
    for m in range(agents):
        for q in range(m + 1, agents):
            for k in range(a_pair):
                at = rng.uniform(-30, 30, 3)
                poses = [Sim3.from_se3(se3(so3_exp(rng.normal(size=3)), at + rng.normal(size=3))) for _ in "mq"]
                ends = [frames[a].inverse() @ pose for a, pose in zip((m, q), poses, strict=True)]
                wrong = se3_exp(rng.normal(0.0, [noise_m] * 3 + [0.003] * 3))
                T_M_Q = ends[0].inverse() @ frames[m].inverse() @ Sim3.from_se3(wrong) @ frames[q] @ ends[1]
                match = MatchId(q, 10 * m + k, m, 10 * q + k)
                end_m, end_q = (End((a, 0), FrameId(a, 0), e) for a, e in zip((m, q), ends, strict=True))
                joints[match] = Joint(end_m, end_q, T_M_Q)
    return Group(joints, {(0, 0): DEPTH * units[0]})


def drifting_group(
    seed: int, agents: int = 4, a_pair: int = 3, drift: tuple[float, ...] = (), rows: tuple[int, ...] = ()
) -> Group:
    """Agents with one camera on one bent street of 200 m: the unit of each drifts on it, by up to 18 % or by ``drift``
    (logarithms); they are matched anywhere, or at ``rows``, 0 to 400."""
    rng = np.random.default_rng(seed)
    at_m = np.linspace(0.0, 200.0, 401)
    angle = at_m / 200.0
    street = 200.0 * np.column_stack([1.0 - np.cos(angle), np.zeros_like(angle), np.sin(angle)])
    drift = drift or tuple(rng.uniform(-0.18, 0.18, agents).tolist())
    logs = [np.log(rng.uniform(0.3, 3.0)) + drift[a] * at_m / 200.0 for a in range(agents)]
    centres = []
    for log in logs:
        steps = np.diff(street, axis=0) * np.exp(log[:-1])[:, None]
        centres.append(np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]))
    joints = {}
    for m in range(agents):
        for q in range(m + 1, agents):
            for k, row in enumerate(rows or rng.integers(0, 401, a_pair).tolist()):
                turn = so3_exp([0.0, float(angle[row]), 0.0])
                ends = [Sim3(turn, centres[a][row]) for a in (m, q)]
                T_M_Q = Sim3(np.eye(3), rng.normal(0.0, 0.02, 3), float(np.exp(logs[m][row] - logs[q][row])))
                match = MatchId(q, 10 * m + k, m, 10 * q + k)
                end_m, end_q = (End((a, 0), FrameId(a, 0), e) for a, e in zip((m, q), ends, strict=True))
                joints[match] = Joint(end_m, end_q, T_M_Q)
    return Group(joints, {(0, 0): DEPTH * float(np.exp(logs[0][0]))})


def displaced(found: Group, liar: int, metres: float) -> Group:
    """All that the liar reported says that its map is elsewhere: the lies agree with each other."""
    beside = Sim3.from_se3(se3(np.eye(3), [metres, 0.0, 0.0]))
    lies = {}
    for match, joint in found.joints.items():
        if match.match_agent == liar:
            unit = 1.0 / joint.match.pose.scale
            away = Sim3(beside.rotation, beside.translation * joint.match.pose.scale, 1.0)
            assert unit > 0
            pose = joint.match.pose
            joint = replace(joint, T_M_Q=pose.inverse() @ away @ pose @ joint.T_M_Q)
        lies[match] = joint
    return Group(lies, found.depths)


@given(st.integers(0, 10_000), st.integers(2, 6), st.floats(0.0, 0.3))
@settings(max_examples=60, deadline=None)
def test_nobody_honest_is_accused(seed: int, agents: int, noise_m: float) -> None:
    found = group(seed, agents, noise_m=noise_m)
    assert contradicted(found.joints, found.depths) == frozenset()


@given(st.integers(0, 10_000), st.floats(40.0, 200.0))
@settings(max_examples=60, deadline=None)
def test_agreeing_lies_are_told_by_the_way_round(seed: int, metres: float) -> None:
    """Agent 1 of five reported its matches with 2, 3 and 4; agent 0 reported those with all others."""
    found = displaced(group(seed, 5), 1, metres)
    lies = {m for m in found.joints if m.match_agent == 1}
    assert lies and contradicted(found.joints, found.depths) == lies


@given(st.integers(0, 10_000), st.integers(3, 6))
@settings(max_examples=60, deadline=None)
def test_nobody_is_accused_because_units_drift(seed: int, agents: int) -> None:
    found = drifting_group(seed, agents)
    assert contradicted(found.joints, found.depths) == frozenset()


def test_what_the_scale_drifted_by_positions_may_be_off() -> None:
    """Joined where they began, three agents come to the end with units that are 38 % apart."""
    found = drifting_group(1, 3, drift=(0.0, 0.19, -0.19), rows=(0, 100, 200, 300, 400))
    assert contradicted(found.joints, found.depths) == frozenset()


@given(st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_drifting_units_hide_no_lies(seed: int) -> None:
    found = displaced(drifting_group(seed, 5), 1, 400.0)
    assert contradicted(found.joints, found.depths) == {m for m in found.joints if m.match_agent == 1}


def test_a_way_round_with_another_scale_is_contradicted() -> None:
    """All positions of one agent's reports are right, and all their scales twice too large."""
    found = drifting_group(6, 5)
    lies = {m: replace(j, T_M_Q=replace(j.T_M_Q, scale=2.0 * j.T_M_Q.scale)) for m, j in found.joints.items()}
    told = {m: lies[m] if m.match_agent == 1 else j for m, j in found.joints.items()}
    assert contradicted(told, found.depths) == {m for m in told if m.match_agent == 1}


def test_between_two_agents_there_is_no_way_round() -> None:
    found = displaced(group(3, 2), 0, 100.0)
    assert contradicted(found.joints, found.depths) == frozenset()


def test_what_does_not_hang_together_with_the_judge_is_not_judged() -> None:
    found = displaced(group(4, 5), 1, 100.0)
    assert contradicted(found.joints, {(9, 0): DEPTH}) == frozenset()
    assert contradicted({}, found.depths) == frozenset()


def test_two_liars_are_more_than_this_can_tell() -> None:
    """No single agent explains it: nothing is left out, the optimisation has to live with it."""
    found = displaced(displaced(group(5, 6), 1, 60.0), 2, 150.0)
    assert contradicted(found.joints, found.depths) == frozenset()
