"""Updates of an elected group: against the central optimum after each match, by what is sent, over bad links."""

import itertools
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
import transports
from graphs import grid, loops, measured
from hypothesis import given, settings
from hypothesis import strategies as st
from transports import until_ended

from maslam.backend.central.costs import cost
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig, LinkModel, SolverConfig
from maslam.backend.distributed.elected import ElectedNode
from maslam.backend.distributed.exchange import optimise_distributed
from maslam.backend.distributed.incremental.additions import between_of, decode_edges, encode_edges
from maslam.backend.distributed.incremental.belief import contradicts, most_rise
from maslam.backend.distributed.incremental.one_by_one import chosen, in_order, matches_one_by_one
from maslam.backend.distributed.incremental.timed_link import TimedLink
from maslam.backend.distributed.incremental.update_node import UpdateNode
from maslam.backend.distributed.share import shares
from maslam.backend.distributed.update_messages import UpdateKind, UpdateMessage, stranger_to
from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3, se3_exp, se3_inverse, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph, Prior, spread_poses

CONFIG = SolverConfig(method="elected")
LINK = LinkModel(solved_anew=0)
SMALL = loops(np.random.default_rng(20), robots=2, length=5, separators=3)


def ready(graph, units=frozenset(), config=CONFIG, careful=False):
    """The robots of a graph after a whole solution."""
    given_ = shares(graph, units)
    nodes = {r: ElectedNode(share, config) for r, share in given_.items()}
    until_ended(nodes)
    return {r: UpdateNode(given_[r], nodes[r].outcome, nodes[r].settled, config, careful) for r in nodes}


def carried(nodes, messages, rng=None, loss=0.0, repeat=0.0):
    """Carry messages until nobody waits for anything; returns all that were delivered."""
    return transports.carried(nodes, messages, lambda: all(n.settled for n in nodes.values()), rng, loss, repeat, 400)


def found(nodes, match):
    """Its two robots have found a match: the messages of both."""
    return [m for r in sorted({match.i.robot, match.j.robot}) for m in nodes[r].add([match])]


def parts(graph, begun=2):
    """What a whole solution begins with, and the matches that come later."""
    joining, later = in_order(graph)
    within = [e for e in graph.edges if not e.is_separator]
    return replace(graph, edges=(*within, *joining, *later[:begun])), later[begun:]


def poses_of(nodes):
    return {n: T for node in nodes.values() for n, T in node.poses.items()}


@pytest.mark.parametrize("seed", range(4))
def test_after_each_match_the_group_is_at_the_central_optimum(seed):
    graph, _ = loops(np.random.default_rng(seed), robots=4, length=25, separators=6, sigma_t=0.05, sigma_deg=1.0)
    graph, later = parts(graph)
    nodes = ready(graph)
    for match in later:
        carried(nodes, found(nodes, match))
        graph = replace(graph, edges=(*graph.edges, match))
        best = optimise(graph, CentralConfig()).cost_after
        assert cost(graph.with_poses(poses_of(nodes)), "F") <= best * (1 + 1e-4)
        assert not any(node.lost for node in nodes.values())
    np.testing.assert_array_equal(nodes[0].poses[NodeId(0, 0)], graph.poses[NodeId(0, 0)])


def test_more_noise_ends_at_the_optimum_too():
    graph, _ = grid(np.random.default_rng(1), sigma=0.15)
    graph, later = parts(graph)
    nodes = ready(graph)
    for match in later[:12]:
        carried(nodes, found(nodes, match))
        graph = replace(graph, edges=(*graph.edges, match))
    best = optimise(graph, CentralConfig()).cost_after
    assert cost(graph.with_poses(poses_of(nodes)), "F") <= best * (1 + 1e-4)


@pytest.mark.parametrize(("seed", "sigma_deg"), [(1, 18.0), (1, 22.0)])
def test_where_odometry_is_far_off_it_ends_near_the_optimum(seed, sigma_deg):
    """A ring that one match closes: a descent from where the poses are ends at another minimum, 3 and 30 % above. In
    so flat a valley solvers end up to 2 % above the best, where depends on rounding."""
    rng, robots, length = np.random.default_rng(seed), 4, 12
    n, truth = robots * length, {}
    for k in range(n):
        angle = 2 * np.pi * k / n
        position = [n / 6 * np.cos(angle), n / 6 * np.sin(angle), 0.0]
        truth[NodeId(k // length, k)] = se3(so3_exp([0.0, 0.0, angle]), position)
    ids, sigma = sorted(truth), np.array([0.05] * 3 + [np.radians(sigma_deg)] * 3)
    pairs, information = [*itertools.pairwise(ids), (ids[0], ids[-1])], np.diag(1 / sigma**2)
    kinds = [EdgeKind.ODOMETRY if a.robot == b.robot else EdgeKind.SEPARATOR for a, b in pairs]
    edges = [measured(truth, a, b, k, sigma, information, rng) for (a, b), k in zip(pairs, kinds, strict=True)]
    poses = {}
    for r in range(robots):
        own = [e for e in edges if e.i.robot == e.j.robot == r]
        poses |= spread_poses({NodeId(r, r * length): np.eye(4)}, own)
    graph = PoseGraph(poses, tuple(edges))
    start, later = parts(graph, begun=0)
    nodes = ready(start)
    for match in later:
        carried(nodes, found(nodes, match))
    best = optimise(graph, CentralConfig()).cost_after
    assert cost(graph.with_poses(poses_of(nodes)), "F") <= 1.02 * best


def test_the_anchor_stays_where_another_robot_is_elected():
    graph, _ = loops(np.random.default_rng(13), robots=3, length=25, separators=5, sigma_t=0.05, sigma_deg=0.5)
    used = max(n.index for e in graph.edges if e.is_separator for n in (e.i, e.j) if n.robot == 0)
    edges = tuple(e for e in graph.edges if e.is_separator or e.i.robot or e.j.index <= used)
    graph = replace(graph, edges=edges, poses={n: T for n, T in graph.poses.items() if n.robot or n.index <= used})
    graph, later = parts(graph)
    nodes = ready(graph)
    assert not nodes[0].leads
    for match in later:
        carried(nodes, found(nodes, match))
    np.testing.assert_array_equal(nodes[0].poses[NodeId(0, 0)], graph.poses[NodeId(0, 0)])


def test_edges_that_overtake_earlier_ones_of_their_sender_wait_for_them():
    graph, _ = loops(np.random.default_rng(14), robots=3, length=25, separators=6, sigma_t=0.05, sigma_deg=0.5)
    graph, later = parts(graph)
    nodes = ready(graph)
    elected = next(r for r, node in nodes.items() if node.leads)
    a, b = (r for r in nodes if r != elected)
    two = [e for e in later if {e.i.robot, e.j.robot} == {a, b}][:2]
    first, second = (found(nodes, match) for match in two)
    assert len(first) == len(second) == 1
    assert nodes[elected].handle(second[0]) == []
    carried(nodes, first)
    best = optimise(replace(graph, edges=(*graph.edges, *two)), CentralConfig()).cost_after
    assert nodes[elected].optimum == pytest.approx(best, rel=1e-4)


def test_a_match_costs_a_small_part_of_solving_anew_in_bytes_and_in_time():
    graph, _ = loops(np.random.default_rng(2), robots=5, length=60, separators=3, sigma_t=0.05, sigma_deg=0.5)
    result = matches_one_by_one(graph, CONFIG, LinkModel(solved_anew=3))
    assert len(result.updates) == len(in_order(graph)[1]) and len(result.anew) == 3
    anew, updates = list(result.anew.values()), result.updates
    assert np.mean([u.bytes_sent for u in updates]) <= 0.2 * np.mean([a.bytes_sent for a in anew])
    assert np.mean([u.seconds for u in updates]) <= 0.2 * np.mean([a.seconds for a in anew])
    assert anew[-1].bytes_sent == optimise_distributed(graph, CONFIG).traffic.wire_bytes
    best = optimise(graph, CentralConfig()).cost_after
    assert cost(result.graph, "F") <= best * (1 + 1e-4)
    again = matches_one_by_one(graph, CONFIG, LINK)
    assert again.updates == result.updates
    for n, T in result.graph.poses.items():
        np.testing.assert_array_equal(again.graph.poses[n], T)


def test_robots_that_a_match_does_not_move_receive_nothing():
    graph, _ = loops(np.random.default_rng(3), robots=4, length=30, separators=6)
    graph, later = parts(graph, begun=12)
    nodes = ready(graph)
    elected = next(r for r, node in nodes.items() if node.leads)
    carried(nodes, found(nodes, later[0]))
    a, b = [r for r in range(4) if r != elected][:2]
    poses = poses_of(nodes)
    match = Edge(NodeId(a, 3), NodeId(b, 7), se3_inverse(poses[NodeId(a, 3)]) @ poses[NodeId(b, 7)], 1e2 * np.eye(6))
    seen = carried(nodes, found(nodes, replace(match, kind=EdgeKind.SEPARATOR)))
    assert [(m.kind, m.receiver) for m in seen] == [(UpdateKind.EDGES, elected), (UpdateKind.RECEIVED, a)]
    assert sum(len(m.encode()) for m in seen) < 100


def test_a_wider_tolerance_sends_less_and_keeps_its_promise():
    graph, _ = loops(np.random.default_rng(4), robots=5, length=30, separators=4, sigma_t=0.05, sigma_deg=0.5)
    sent = []
    for tolerance in (1e-6, 1e-2):
        result = matches_one_by_one(graph, CONFIG.model_copy(update={"update_tolerance": tolerance}), LINK)
        assert all(u.cost <= u.optimum * (1 + tolerance) for u in result.updates)
        best = optimise(graph, CentralConfig()).cost_after
        assert cost(result.graph, "F") <= best * (1 + tolerance + 1e-4)
        sent.append(sum(u.bytes_sent for u in result.updates))
    assert sent[1] < 0.8 * sent[0]


@pytest.mark.parametrize("seed", range(3))
def test_lost_repeated_and_overtaken_messages_change_nothing(seed):
    graph, _ = loops(np.random.default_rng(5), robots=4, length=25, separators=5, sigma_t=0.05, sigma_deg=1.0)
    graph, later = parts(graph)
    nodes, rng = ready(graph), np.random.default_rng(seed)
    for k in range(0, len(later), 2):
        # The second comes while answers to the first are on their way.
        messages = [m for match in later[k : k + 2] for m in found(nodes, match)]
        carried(nodes, messages, rng, loss=0.3, repeat=0.3)
        graph = replace(graph, edges=(*graph.edges, *later[k : k + 2]))
        assert not any(node.lost for node in nodes.values())
    best = optimise(graph, CentralConfig()).cost_after
    assert cost(graph.with_poses(poses_of(nodes)), "F") <= best * (1 + 1e-4)


def test_robots_drive_on_between_matches_and_close_loops_of_their_own():
    whole, truth = loops(np.random.default_rng(6), robots=3, length=60, separators=8, sigma_t=0.05, sigma_deg=0.5)
    known = 30
    early = [e for e in whole.edges if max(e.i.index, e.j.index) < known]
    graph = replace(whole, poses={n: T for n, T in whole.poses.items() if n.index < known}, edges=tuple(early))
    # A circle's first half meets its neighbour's at few places: tie the three.
    for a, b in ((0, 1), (1, 2), (0, 2)):
        T = se3_inverse(truth[NodeId(a, 5)]) @ truth[NodeId(b, 9)]
        tie = Edge(NodeId(a, 5), NodeId(b, 9), T @ se3_exp(0.02 * np.ones(6)), 50 * np.eye(6), EdgeKind.SEPARATOR)
        graph = replace(graph, edges=(*graph.edges, tie))
    nodes = ready(graph)
    at = dict.fromkeys(nodes, known)
    coming = sorted((e for e in whole.edges if e not in early and e.is_separator), key=lambda e: (e.i.index, e.j.index))
    loop = Edge(NodeId(0, 2), NodeId(0, 50), se3_inverse(truth[NodeId(0, 2)]) @ truth[NodeId(0, 50)])
    for match in [*coming[:6], replace(loop, information=50 * np.eye(6), kind=EdgeKind.LOOP), *coming[6:]]:
        messages = []
        for r in sorted({match.i.robot, match.j.robot}):
            last = max(n.index for n in (match.i, match.j) if n.robot == r)
            chain = [e for e in whole.edges if e.i.robot == e.j.robot == r and at[r] <= e.j.index <= last]
            before = NodeId(r, at[r] - 1)
            grown = spread_poses({before: nodes[r].poses[before]}, chain)
            new = {n: T for n, T in grown.items() if n != before}
            at[r] = max(at[r], last + 1)
            # The other robot's odometry may come later than the match that names it.
            messages = [*nodes[r].add([*chain, match], new), *messages]
            graph = replace(graph, poses={**graph.poses, **new}, edges=(*graph.edges, *chain))
        carried(nodes, messages)
        graph = replace(graph, edges=(*graph.edges, match))
        best = optimise(graph, CentralConfig()).cost_after
        assert cost(graph.with_poses(poses_of(nodes)), "F") <= best * (1 + 1e-4)
    assert max(at.values()) > known + 20


def test_corrections_stay_small_over_many_matches():
    """Products of many rotations are made rotations again; what is left off would triple with each."""
    graph, _ = loops(np.random.default_rng(7), robots=3, length=20, separators=24, sigma_t=0.05, sigma_deg=0.5)
    result = matches_one_by_one(graph, CONFIG, LINK)
    sizes = [u.bytes_sent for u in result.updates]
    assert len(sizes) > 60 and max(sizes[-10:]) < 4 * np.median(sizes)
    for T in result.graph.poses.values():
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)


def test_units_of_length_are_updated_too():
    graph, _ = loops(np.random.default_rng(8), robots=3, length=20, separators=5, sigma_t=0.02, sigma_deg=0.3)
    graph = replace(graph, edges=tuple(replace(e, scale_sigma=0.01) for e in graph.edges))
    monocular = frozenset({1, 2})
    result = matches_one_by_one(graph, CONFIG, LINK, monocular)
    anew = optimise_distributed(graph, CONFIG, monocular)
    for n, T in anew.graph.poses.items():
        assert np.linalg.norm(result.graph.poses[n][:3, 3] - T[:3, 3]) < 0.01
        assert result.units[n] == pytest.approx(anew.units[n], rel=0.01)


def test_a_state_that_does_not_fit_is_found_out_and_told_to_all():
    graph, _ = loops(np.random.default_rng(9), robots=3, length=20, separators=5)
    graph, later = parts(graph)
    # A robot that has missed nothing by number, but has other corrections than it was sent.
    nodes = ready(graph)
    elected = next(r for r, node in nodes.items() if node.leads)
    messages = [m for match in later[:3] for m in carried(nodes, found(nodes, match))]
    sent = [m for m in messages if m.kind is UpdateKind.CORRECTION]
    fresh = ready(graph)
    wrong = replace(sent[0], body=bytes([sent[0].body[0] ^ 1]) + sent[0].body[1:])
    out = fresh[wrong.receiver].handle(wrong)
    assert fresh[wrong.receiver].lost and [m.kind for m in out] == [UpdateKind.LOST]
    carried(fresh, out)
    assert fresh[elected].lost
    # Of another solution: its sender learns of it, the receiver goes on.
    fresh = ready(graph)
    other = replace(sent[0], epoch=sent[0].epoch ^ 1)
    out = fresh[other.receiver].handle(other)
    assert fresh[other.receiver].lost is None and out[0].epoch == other.epoch and out[0].kind is UpdateKind.LOST
    # The elected robot falls silent.
    fresh = ready(graph)
    match = next(m for m in later if elected not in (m.i.robot, m.j.robot))
    member = fresh[min(match.i.robot, match.j.robot)]
    assert member.add([match])
    for _ in range(2 * CONFIG.elected_patience + 1):
        member.tick()
    assert member.lost == f"robot {elected} does not answer"


def test_an_edge_that_the_elected_robot_cannot_place_ends_in_solving_anew():
    graph, _ = loops(np.random.default_rng(10), robots=3, length=40, separators=3)
    graph, _ = parts(graph, begun=3)
    nodes = ready(graph, config=CONFIG.model_copy(update={"elected_longest": 1000}))
    free = {n for r in range(3) for n in (NodeId(r, k) for k in range(40))}
    free -= {n for e in graph.edges if e.is_separator for n in (e.i, e.j)}
    i, j = (next(n for n in sorted(free) if n.robot == r and n.index > 1) for r in (0, 1))
    carried(nodes, found(nodes, Edge(i, j, np.eye(4), np.eye(6), EdgeKind.SEPARATOR)))
    assert any("left out of what its robot contributed" in (node.lost or "") for node in nodes.values())


def test_what_updates_cannot_do_is_refused():
    graph, _ = loops(np.random.default_rng(11), robots=3, length=10, separators=2)
    apart = replace(graph, edges=tuple(e for e in graph.edges if 2 not in (e.i.robot, e.j.robot) or not e.is_separator))
    with pytest.raises(BackendError, match="no edge joins robot 2 to the others"):
        matches_one_by_one(apart, CONFIG, LINK)
    with pytest.raises(BackendError, match="no priors"):
        matches_one_by_one(replace(graph, priors=(Prior(NodeId(0, 0), np.eye(4)),)), CONFIG, LINK)
    nodes = ready(graph)
    elected = next(r for r, node in nodes.items() if node.leads)
    stray = UpdateMessage(UpdateKind.CORRECTION, 0, 1, (elected + 1) % 3, (elected + 2) % 3)
    with pytest.raises(BackendError, match="not elected"):
        nodes[stray.receiver].handle(stray)


def test_edges_come_back_within_half_a_step():
    graph, _ = loops(np.random.default_rng(12), robots=3, length=6, separators=2)
    sent = between_of(graph.edges, 3)
    back = decode_edges(encode_edges(sent, 256.0, False), False)
    assert back.nodes == sent.nodes
    np.testing.assert_allclose(back.edges.kappa, sent.edges.kappa, rtol=1e-6)
    np.testing.assert_allclose(back.edges.measured, sent.edges.measured, atol=1e-3)


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=60), st.booleans())
def test_damaged_edges_raise_no_other_error(data, scaled):
    with suppress(BackendError):
        decode_edges(data, scaled)
    with suppress(BackendError):
        UpdateMessage.decode(data)


def test_a_radio_sends_one_message_after_the_other():
    link = TimedLink(delay_s=0.5, rate_kbit=8.0)
    for sender, size in ((0, 1000), (0, 500), (1, 100)):
        link.send(sender, bytes(size), 0.0)
    arrivals = [link.next() for _ in range(3)]
    assert [(a.at_s, len(a.data)) for a in arrivals] == [(0.6, 100), (1.5, 1000), (2.0, 500)]
    assert link.next() is None and link.bytes_sent == 1600
    assert chosen(10, 3) == [2, 6, 9] and chosen(2, 5) == [0, 1] and chosen(5, 0) == []


def test_a_match_counts_once_both_of_its_robots_have_given_it():
    graph, _ = loops(np.random.default_rng(15), robots=3, length=25, separators=6, sigma_t=0.05, sigma_deg=0.5)
    graph, later = parts(graph, begun=6)
    nodes = ready(graph, careful=True)
    elected = next(r for r, node in nodes.items() if node.leads)
    match = next(m for m in later if elected not in (m.i.robot, m.j.robot))
    before, (low, high) = nodes[elected].optimum, sorted((match.i.robot, match.j.robot))
    carried(nodes, nodes[low].add([match]))
    assert nodes[elected].optimum == before and nodes[elected].revision == 0
    carried(nodes, nodes[high].add([match]))
    best = optimise(replace(graph, edges=(*graph.edges, match)), CentralConfig()).cost_after
    assert nodes[elected].optimum == pytest.approx(best, rel=1e-4) != pytest.approx(before, rel=1e-4)
    assert not any(node.lost for node in nodes.values())


@pytest.mark.parametrize("seed", range(2))
def test_careful_updates_end_at_the_central_optimum_over_bad_links_too(seed):
    graph, _ = loops(np.random.default_rng(16), robots=4, length=25, separators=5, sigma_t=0.05, sigma_deg=1.0)
    graph, later = parts(graph, begun=4)
    nodes, rng = ready(graph, careful=True), np.random.default_rng(seed)
    for match in later:
        carried(nodes, found(nodes, match), rng, loss=0.3, repeat=0.3)
        graph = replace(graph, edges=(*graph.edges, match))
        assert not any(node.lost for node in nodes.values()), [node.lost for node in nodes.values()]
    best = optimise(graph, CentralConfig()).cost_after
    assert cost(graph.with_poses(poses_of(nodes)), "F") <= best * (1 + 1e-4)


def test_a_match_that_the_others_contradict_ends_updates_and_moves_nobody():
    graph, truth = loops(np.random.default_rng(17), robots=4, length=25, separators=6, sigma_t=0.05, sigma_deg=0.5)
    graph, later = parts(graph, begun=8)
    for off, believed in ((0.05, True), (2.0, False)):
        nodes = ready(graph, careful=True)
        elected = next(r for r, node in nodes.items() if node.leads)
        match = next(m for m in later if elected not in (m.i.robot, m.j.robot))
        T = se3_inverse(truth[match.i]) @ truth[match.j] @ se3_exp([off, 0, 0, 0, 0, 0])
        before = poses_of(nodes)
        carried(nodes, found(nodes, replace(match, T_i_j=T)))
        assert all((node.lost is None) == believed for node in nodes.values()), off
        if not believed:
            assert "contradict" in nodes[elected].lost
            assert all(np.array_equal(T, before[n]) for n, T in poses_of(nodes).items())


def test_a_correction_that_own_edges_contradict_is_not_taken():
    """The elected robot has a loop in a member's name that the member never gave."""
    graph, truth = loops(np.random.default_rng(18), robots=3, length=25, separators=6, sigma_t=0.05, sigma_deg=0.5)
    graph, _ = parts(graph, begun=6)
    nodes = ready(graph, careful=True)
    member = next(r for r, node in nodes.items() if not node.leads)
    i, j = NodeId(member, 2), NodeId(member, 22)
    T = se3_inverse(truth[i]) @ truth[j] @ se3_exp([0.6, 0, 0, 0, 0, 0])
    forged = ready(graph, careful=True)[member].add([Edge(i, j, T, 50 * np.eye(6), EdgeKind.LOOP)])
    before = nodes[member].poses
    carried(nodes, forged)
    assert nodes[member].lost.startswith("own edges cost")
    assert all(node.lost for node in nodes.values())
    assert all(np.array_equal(T, before[n]) for n, T in nodes[member].poses.items())


def test_an_own_edge_that_a_correction_tears_is_noticed():
    calm, torn = np.full(20, 0.1), np.full(20, 0.1)
    torn[3] = 60.0
    assert contradicts(calm, calm, float(calm.sum()), 0.002) == ""
    assert contradicts(calm, torn, None, 0.002).startswith("a correction tears an own edge: 60, 38.26")
    assert contradicts(torn, torn, None, 0.002) == ""
    assert contradicts(calm, calm, 3.0, 0.002) == "own edges cost 2 with a correction, not 3"
    assert contradicts(calm, calm, float("nan"), 0.002) == "a correction leaves own edges without a cost"


def test_a_match_that_is_withdrawn_counts_no_more_until_it_is_given_again():
    graph, _ = loops(np.random.default_rng(21), robots=3, length=25, separators=6, sigma_t=0.05, sigma_deg=0.5)
    graph, later = parts(graph, begun=6)
    nodes = ready(graph, careful=True)
    elected = next(r for r, node in nodes.items() if node.leads)
    whole = next(e for e in graph.edges if e.is_separator and elected not in (e.i.robot, e.j.robot))
    update = next(m for m in later if elected not in (m.i.robot, m.j.robot))
    carried(nodes, found(nodes, update))

    def best(*edges):
        return optimise(replace(graph, edges=edges), CentralConfig()).cost_after

    # Of the whole solution and of an update; by the robot that gives it and by the one that names it.
    for match, robot in itertools.product((whole, update), sorted((whole.i.robot, whole.j.robot))):
        both = (*graph.edges, update)
        carried(nodes, nodes[robot].add([], withdrawn=[(match.i, match.j)]))
        assert nodes[elected].optimum == pytest.approx(best(*(e for e in both if e is not match)), rel=1e-4)
        carried(nodes, nodes[robot].add([match]))
        assert nodes[elected].optimum == pytest.approx(best(*both), rel=1e-4)
    assert not any(node.lost for node in nodes.values()), [node.lost for node in nodes.values()]


def test_without_the_only_match_of_a_robot_updates_end():
    graph, _ = loops(np.random.default_rng(22), robots=3, length=25, separators=6, sigma_t=0.05, sigma_deg=0.5)
    ties = [e for e in graph.edges if e.is_separator and 2 in (e.i.robot, e.j.robot)]
    graph = replace(graph, edges=tuple(e for e in graph.edges if e not in ties[1:]))
    nodes = ready(graph, careful=True)
    carried(nodes, nodes[2].add([], withdrawn=[(ties[0].i, ties[0].j)]))
    assert "does not hang together" in next(node.lost for node in nodes.values() if node.leads)
    assert all(node.lost for node in nodes.values())


def test_all_learn_that_updates_have_ended_whatever_is_lost():
    graph, _ = loops(np.random.default_rng(19), robots=4, length=12, separators=4)
    for seed, loser in itertools.product(range(3), range(4)):
        nodes = ready(graph, careful=True)
        carried(nodes, nodes[loser].lose("for a test"), np.random.default_rng(seed), loss=0.5)
        assert all(node.lost for node in nodes.values())
        own = next(e for e in graph.edges if e.i.robot == e.j.robot == 2)
        assert nodes[2].add([own]) == []


def test_messages_of_another_solution_are_answered_once():
    """Two robots of different solutions would else answer each other for ever."""
    given_ = UpdateMessage(UpdateKind.EDGES, 7, 1, 0, 1, b"\x00")
    (lost,) = stranger_to(given_)
    (received,) = stranger_to(lost)
    assert (lost.kind, lost.epoch, lost.receiver) == (UpdateKind.LOST, 7, 0)
    assert received.kind is UpdateKind.RECEIVED and stranger_to(received) == []


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=40))
def test_damaged_bodies_are_refused_and_change_nothing(data):
    graph, _ = SMALL
    nodes = ready(graph, careful=True)
    elected = next(r for r, node in nodes.items() if node.leads)
    member = next(r for r in nodes if r != elected)
    (sent,) = nodes[member].add([next(e for e in graph.edges if e.i.robot == e.j.robot == member)])
    before, optimum = nodes[member].poses, nodes[elected].optimum
    with suppress(BackendError):
        nodes[elected].handle(replace(sent, body=data))
    with suppress(BackendError):
        nodes[member].handle(UpdateMessage(UpdateKind.CORRECTION, sent.epoch, 1, elected, member, data))
    assert nodes[member].lost or all(np.array_equal(T, before[n]) for n, T in nodes[member].poses.items())
    assert nodes[elected].lost or nodes[elected].optimum <= optimum * 1.1


def test_what_right_edges_raise_the_cost_by_is_one_in_a_millions_bound():
    """Of chi-square with 6 degrees of freedom one in a million exceeds 38.26 (tables)."""
    assert most_rise(0.0, 0, 6) == pytest.approx(38.26, abs=0.01)
    assert most_rise(0.0, 100, 0) == 0.0
    assert most_rise(400.0, 100, 6) == pytest.approx(4 * 38.26 + 4, abs=0.05)
