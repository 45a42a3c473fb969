"""Which matches agree, and what a group optimises with them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from factory import circuit, drift, heading, rescaled, travelled_by

from maslam.backend.geometry import Sim3, se3_exp, se3_inverse
from maslam.mas.config import ConsistencyConfig
from maslam.mas.optimisation.planning import plan
from maslam.mas.protocol.ids import FrameId, MatchId
from maslam.mas.protocol.messages import LINK_DTYPE, Bid, Links, PieceTerms
from maslam.mas.protocol.tensors import pack_sim3s, unpack_sim3s
from maslam.mas.state.place_match import Agreement, Match, MatchEnd

CONFIG = ConsistencyConfig()


def matches_between(count: int, seed: int = 0, unit_M: float = 1.0, unit_Q: float = 1.0) -> list[Match]:
    """True matches, with 1 cm of noise, between two agents that drove the same way with drifting odometry."""
    rng = np.random.default_rng(seed)
    truth = circuit(0.0, 60.0, step_m=1.5)
    tracks = [drift(truth, rng, share=0.01), drift(truth, rng, share=0.01)]
    ways = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1))])
    out = []
    for m in range(2, 2 + 3 * count, 3):
        q = m + 1
        T_M_Q = se3_inverse(truth[m]) @ truth[q] @ se3_exp(rng.normal(0.0, [0.01] * 3 + [0.001] * 3))
        T_T_M, T_T_Q = tracks[0][m].copy(), tracks[1][q].copy()
        T_T_M[:3, 3] /= unit_M
        T_T_Q[:3, 3] /= unit_Q
        sim = Sim3(T_M_Q[:3, :3], T_M_Q[:3, 3] / unit_M, unit_Q / unit_M)
        ends = MatchEnd(0, T_T_Q, ways[q] / unit_Q), MatchEnd(0, T_T_M, ways[m] / unit_M)
        out.append(Match(MatchId(1, q, 0, m), *ends, sim, np.eye(6), 50, 10.0 / unit_M))
    return out


WAYS = {
    "round": circuit(0.0, 180.0, step_m=1.5),
    "straight": np.array([heading(0.0, z, 0.0) for z in np.arange(0.0, 180.0, 1.5)]),
    "out and back": np.array(
        [heading(0.0, z, 0.0) for z in np.arange(0.0, 90.0, 1.5)]
        + [heading(0.0, z, np.pi) for z in np.arange(90.0, 0.0, -1.5)]
    ),
}


def matches_with_drift(rate: float, seed: int = 0, way: str = "round") -> list[Match]:
    """True matches of two drives on one way: the unit of both drifts, the second drive's by ``rate`` (logarithm) for
    each metre more than the first one's."""
    rng = np.random.default_rng(seed)
    truth = WAYS[way]
    travelled = travelled_by(truth)
    scales = [np.exp(-0.3 * rate * travelled), 1.2 * np.exp(0.7 * rate * travelled)]
    tracks = [rescaled(drift(truth, rng, share=0.003, yaw_deg=0.01), s) for s in scales]
    ways = [travelled_by(track) for track in tracks]
    out = []
    for m in range(2, len(truth) - 1, 8):
        q = m + 1
        T_M_Q = se3_inverse(truth[m]) @ truth[q] @ se3_exp(rng.normal(0.0, [0.01] * 3 + [0.001] * 3))
        u_m, u_q = float(scales[0][m]), float(scales[1][q])
        noise = float(np.exp(rng.normal(0.0, 0.01)))
        sim = Sim3(T_M_Q[:3, :3], T_M_Q[:3, 3] * u_m, u_m / u_q * noise)
        ends = MatchEnd(1, tracks[1][q], ways[1][q]), MatchEnd(0, tracks[0][m], ways[0][m])
        out.append(Match(MatchId(0, 1000 + q, 0, m), *ends, sim, np.eye(6), 50, 10.0 * u_m, 0.01))
    return out


def spoiled(match: Match, metres: float = 3.0) -> Match:
    m = match.id
    off = np.array([0.0, 0.0, metres * match.depth / 10.0])
    wrong = Sim3(match.T_M_Q.rotation, match.T_M_Q.translation + off, match.T_M_Q.scale)
    return replace(match, id=MatchId(m.query_agent, m.query + 1, m.match_agent, m.match), T_M_Q=wrong)


def consistent(matches: Iterable[Match], config: ConsistencyConfig) -> set[MatchId]:
    agreement = Agreement(config)
    for match in matches:
        agreement.add(match)
    return agreement.accepted()


@pytest.mark.parametrize("units", [(1.0, 1.0), (0.2, 5.0)], ids=["metric", "own units"])
def test_true_matches_agree_in_any_unit(units: tuple[float, float]) -> None:
    matches = matches_between(8, unit_M=units[0], unit_Q=units[1])
    assert consistent(matches, CONFIG) == {m.id for m in matches}


def test_a_wrong_match_is_left_out_and_spoils_no_other() -> None:
    matches = matches_between(6)
    wrong = spoiled(matches[2])
    assert consistent([*matches, wrong], CONFIG) == {m.id for m in matches}


def test_one_match_alone_is_not_believed_until_another_agrees() -> None:
    first, second, *_ = matches_between(3)
    assert consistent([first], CONFIG) == set()
    assert consistent([first, spoiled(second)], CONFIG) == set()
    assert consistent([first, spoiled(second), second], CONFIG) == {first.id, second.id}
    assert consistent([first], ConsistencyConfig(min_support=0)) == {first.id}


def test_both_owners_come_to_the_same_set() -> None:
    matches = [*matches_between(5), spoiled(matches_between(5)[3])]
    assert consistent(matches, CONFIG) == consistent(reversed(matches), CONFIG)


PREDECESSOR = ConsistencyConfig(rule="earlier", min_support=2)


def test_the_predecessors_group_wants_two_earlier_matches() -> None:
    matches = matches_between(6)  # 4.5 m apart on the way: four of them lie within 20 m
    assert consistent(matches, PREDECESSOR) == {m.id for m in matches[2:]}
    assert consistent(matches[:2], PREDECESSOR) == set()
    assert consistent(reversed(matches), PREDECESSOR) == {m.id for m in matches[2:]}
    wrong = spoiled(matches[3], metres=6.0)
    assert consistent([*matches, wrong], PREDECESSOR) == {m.id for m in matches[2:]}
    near = spoiled(matches[3], metres=3.0)  # within its 4 m, which our own rule does not believe
    assert near.id in consistent([*matches, near], PREDECESSOR)
    assert near.id not in consistent([*matches, near], CONFIG)


def test_the_predecessors_group_forgets_what_is_behind() -> None:
    matches = matches_between(8)
    sparse = [matches[0], matches[1], matches[7]]  # the last one is 27 m farther on
    assert consistent(sparse, PREDECESSOR) == set()
    assert consistent(sparse, PREDECESSOR.model_copy(update={"earlier_m": 40.0})) == {matches[7].id}


def test_a_match_seen_from_the_other_side_says_the_same() -> None:
    a, b, *_ = matches_between(3)
    assert len(consistent([a, b.turned()], CONFIG)) == 2
    np.testing.assert_allclose(a.turned().joins().matrix(), a.joins().inverse().matrix(), atol=1e-9)
    back = a.turned().turned()
    np.testing.assert_allclose(back.T_M_Q.matrix(), a.T_M_Q.matrix(), atol=1e-9)
    assert back.id == a.id


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("rate", [0.0, 0.0016, -0.0016])
def test_matches_agree_up_to_the_drift_of_the_unit(rate: float, way: str) -> None:
    """Two drives of 180 m, over which the units drift apart by 29 %; odometry is better than what is allowed for."""
    config = ConsistencyConfig(drift=0.012)
    for seed in range(5):
        matches = matches_with_drift(rate, seed, way)
        scales = [m.T_M_Q.scale for m in matches]
        assert abs(np.log(scales[-1] / scales[0]) + 174.0 * rate) < 0.06
        assert consistent(matches, config) == {m.id for m in matches}
        assert consistent([m.turned() for m in matches], config) == {m.turned().id for m in matches}


@pytest.mark.parametrize("rate", [0.0, 0.0016])
def test_drift_of_the_unit_is_no_excuse_for_another_place(rate: float) -> None:
    """A match 6 m off at 10 m of depth, and one whose scale nothing between explains, are left out."""
    matches = matches_with_drift(rate)
    right = {m.id for m in matches}
    for at in (3, 7):
        off = spoiled(matches[at], metres=6.0)
        bigger = replace(spoiled(matches[at], metres=0.0), T_M_Q=replace(matches[at].T_M_Q, scale=1.6))
        for wrong in (off, bigger):
            assert consistent([*matches, wrong], CONFIG) == right


# -- plans ------------------------------------------------------------------------------------------------------------


def bid(
    agent: int,
    rows: list[tuple[MatchId, bool, Sim3, Sim3]],
    tracks: tuple[int, ...] = (0,),
    metric: bool = True,
    frame: FrameId | None = None,
) -> Bid:
    """Rows: match, whether this agent asked, its key-frame's pose, ``T_M_Q``. ``frame``: the coordinates of all; its
    own if None."""
    links = Links(
        tuple(m for m, *_ in rows),
        tuple(0 for _ in rows),
        tuple(frame or FrameId(agent, 0) for _ in rows),
        tuple(asked for _, asked, *_ in rows),
        pack_sim3s([pose for *_, pose, _ in rows], LINK_DTYPE),
        pack_sim3s([T_M_Q for _, asked, _, T_M_Q in rows if asked], LINK_DTYPE),
    )
    return Bid(0, 0, links, tuple(PieceTerms(t, frame or FrameId(agent, t), metric, metric) for t in tracks))


def random_sim3(rng: np.random.Generator, unit: float) -> Sim3:
    pose = se3_exp(rng.normal(size=6))
    return Sim3(pose[:3, :3], pose[:3, 3], unit)


def test_everyone_is_placed_in_the_lowest_members_frame() -> None:
    """A chain 2 - 5 - 9, in units 1, 2 and 0.5 of the anchor's; the manager is its last link."""
    rng = np.random.default_rng(1)
    units = {2: 1.0, 5: 2.0, 9: 0.5}
    T_2_frame = {2: Sim3.identity(), 5: random_sim3(rng, 2.0), 9: random_sim3(rng, 0.5)}
    rows: dict[int, list[tuple[MatchId, bool, Sim3, Sim3]]] = {2: [], 5: [], 9: []}
    for m, q in ((2, 5), (9, 5)):
        match = MatchId(q, 4, m, 6)
        pose_m, pose_q = random_sim3(rng, 1.0), random_sim3(rng, 1.0)
        T_M_Q = pose_m.inverse() @ T_2_frame[m].inverse() @ T_2_frame[q] @ pose_q
        rows[m].append((match, False, pose_m, T_M_Q))
        rows[q].append((match, True, pose_q, T_M_Q))
    found = plan(9, {a: bid(a, rows[a], metric=False) for a in units})
    assert found.members == (2, 5, 9)
    for agent, task in found.tasks.items():
        assert task.frame == FrameId(2, 0)
        placed = unpack_sim3s(task.placements)[0]
        # Bids tell poses in single precision.
        np.testing.assert_allclose(placed.matrix(), T_2_frame[agent].matrix(), atol=1e-5)
    assert len(found.tasks[5].matches) == 2 and len(found.tasks[2].matches) == 1


def test_a_match_that_only_one_side_holds_joins_nobody() -> None:
    match = MatchId(1, 4, 0, 6)
    one_sided = plan(0, {0: bid(0, [(match, False, Sim3.identity(), Sim3.identity())]), 1: bid(1, [])})
    assert one_sided.members == (0,) and one_sided.tasks[0].matches == ()


def test_tracks_that_nothing_joins_stay_out() -> None:
    match = MatchId(1, 4, 0, 6)
    rows = (match, False, Sim3.identity(), Sim3.identity()), (match, True, Sim3.identity(), Sim3.identity())
    found = plan(1, {0: bid(0, [rows[0]], tracks=(0, 1)), 1: bid(1, [rows[1]])})
    assert found.tasks[0].tracks == (0,) and found.members == (0, 1)
