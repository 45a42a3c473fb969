"""Robots that exchange only separator poses: against the central solution, and under transports that misbehave."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from graphs import constant_units, grid, loops, measured
from hypothesis import given
from hypothesis import strategies as st

from maslam.backend.central.costs import cost
from maslam.backend.central.optimise import optimise, two_stage
from maslam.backend.config import CentralConfig, SolverConfig
from maslam.backend.distributed.exchange import optimise_distributed
from maslam.backend.distributed.message_bytes import decode, encode
from maslam.backend.distributed.messages import Decision, Deltas, Report, SeparatorState, Standing, Status, Values
from maslam.backend.distributed.methods import node_for
from maslam.backend.distributed.node import Node
from maslam.backend.distributed.share import shares
from maslam.backend.distributed.solver_stage import WIDTH, Round, SolverStage, as_sent, number_type
from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3_exp, se3_inverse
from maslam.backend.pose_graph.graph import EdgeKind, NodeId

EXACT = {"rotation_threshold": 1e-10, "pose_threshold": 1e-10, "rotation_sweeps": 2000, "pose_sweeps": 2000}


def in_frame_of(truth, anchor, pose):
    """The truth moved so that the anchor stands at ``pose``."""
    return {n: pose @ se3_inverse(truth[anchor]) @ T for n, T in truth.items()}


@pytest.mark.parametrize("method", ["dgs", "sor"])
def test_exact_measurements_give_the_truth_from_own_frames(method):
    graph, truth = loops(np.random.default_rng(0), robots=3, length=30, sigma_t=0.0, sigma_deg=0.0)
    result = optimise_distributed(graph, SolverConfig(method=method, **EXACT))
    expected = in_frame_of(truth, NodeId(0, 0), graph.poses[NodeId(0, 0)])
    for node in truth:
        np.testing.assert_allclose(result.graph.poses[node], expected[node], atol=1e-6)
    assert all(o.accepted and not o.unreached for o in result.outcomes.values())
    assert result.outcomes[0].cost_after < 1e-9 < result.outcomes[0].cost_before


@pytest.mark.parametrize("method", ["dgs", "jor", "sor"])
def test_the_fixed_point_is_the_central_two_stage_solution(method):
    graph, _ = grid(np.random.default_rng(1))
    result = optimise_distributed(graph, SolverConfig(method=method, **EXACT))
    central = two_stage(graph)
    for node in graph.nodes:
        np.testing.assert_allclose(result.graph.poses[node], central.poses[node], atol=1e-6)
    assert result.outcomes[0].cost_after == pytest.approx(cost(central, "F"), rel=1e-7)


def test_further_newton_steps_reach_the_optimum():
    graph, _ = grid(np.random.default_rng(2), sigma=0.15)
    optimum = optimise(graph, CentralConfig()).cost_after
    one = optimise_distributed(graph, SolverConfig(**EXACT)).outcomes[0].cost_after
    eight = optimise_distributed(graph, SolverConfig(newton_steps=8, **EXACT)).outcomes[0].cost_after
    assert one > optimum * 1.005
    assert eight == pytest.approx(optimum, rel=2e-5)


def test_only_separators_travel_and_all_end_at_the_same_sweep():
    graph, _ = loops(np.random.default_rng(3), robots=4, length=40, separators=5)
    group = shares(graph)
    seen = {(e.i, e.j) for e in graph.edges if e.is_separator}
    separators = {r: {n for pair in seen for n in pair if n.robot == r} for r in group}
    nodes = {r: Node(s, SolverConfig()) for r, s in group.items()}
    queue = deque(m for n in nodes.values() for m in n.start())
    while queue:
        message = queue.popleft()
        if isinstance(message, Values):
            mine, _ = group[message.sender].separators_with(message.receiver)
            assert set(mine) <= separators[message.sender] and len(message.values) in (0, len(mine))
        queue.extend(nodes[message.receiver].handle(message))
    ends = {(n.outcome.rotation_sweeps, n.outcome.pose_sweeps, n.outcome.cost_after) for n in nodes.values()}
    assert len(ends) == 1
    total = cost(graph.with_poses({k: T for n in nodes.values() for k, T in n.outcome.poses.items()}), "F")
    assert nodes[2].outcome.cost_after == pytest.approx(total, rel=1e-9)


def test_a_warm_start_takes_fewer_sweeps():
    graph, _ = loops(np.random.default_rng(6), robots=4, length=40)
    *fewer, last = graph.edges
    config = SolverConfig(rotation_threshold=1e-3, pose_threshold=1e-3, pose_sweeps=500)
    before = optimise_distributed(replace(graph, edges=tuple(fewer)), config).graph
    again = replace(before, edges=graph.edges)
    cold = optimise_distributed(again, config)
    warm = optimise_distributed(again, config.model_copy(update={"start": "warm"}))
    assert warm.outcomes[0].pose_sweeps < cold.outcomes[0].pose_sweeps
    assert warm.traffic.payload_bytes < 0.8 * cold.traffic.payload_bytes
    assert last.is_separator


def test_an_edge_of_weight_zero_is_as_good_as_absent():
    rng = np.random.default_rng(7)
    graph, truth = grid(rng)
    wrong = measured(truth, NodeId(0, 0), NodeId(3, 4), EdgeKind.SEPARATOR, np.zeros(6), 100 * np.eye(6), rng)
    wrong = replace(wrong, T_i_j=wrong.T_i_j @ se3_exp([5.0, 0, 0, 0, 1.0, 0]))
    config = SolverConfig(**EXACT)
    clean = optimise_distributed(graph, config).graph
    weights = [*(1.0 for _ in graph.edges), 0.0]
    muted = optimise_distributed(replace(graph, edges=(*graph.edges, wrong)).with_weights(weights), config).graph
    for node in graph.nodes:
        np.testing.assert_allclose(muted.poses[node], clean.poses[node], atol=1e-6)


def test_robots_with_units_of_their_own_find_them():
    rng = np.random.default_rng(8)
    graph, truth = loops(rng, robots=3, length=30, sigma_t=0.005, sigma_deg=0.05)
    units = {0: 1.0, 1: 2.5, 2: 0.4}
    own = constant_units(graph.rescaled({r: 1.0 / u for r, u in units.items()}))
    result = optimise_distributed(own, SolverConfig(start="flagged"), arbitrary_scale=frozenset({0, 1, 2}))
    for robot, outcome in result.outcomes.items():
        assert outcome.units[NodeId(robot, 3)] == pytest.approx(units[robot], rel=1e-3)
    expected = in_frame_of(truth, NodeId(0, 0), own.poses[NodeId(0, 0)])
    errors = [np.linalg.norm((result.graph.poses[n] - expected[n])[:3, 3]) for n in truth]
    assert max(errors) < 0.25
    # With one metric robot the unit is the metre, whoever is the anchor.
    mixed = optimise_distributed(own, SolverConfig(), arbitrary_scale=frozenset({0, 2}))
    assert mixed.outcomes[1].units[NodeId(1, 3)] == 1.0
    assert mixed.outcomes[0].units[NodeId(0, 3)] == pytest.approx(1.0 / 2.5, rel=1e-3)


def test_a_share_that_contradicts_itself_is_an_error():
    graph, _ = loops(np.random.default_rng(11), robots=2, length=10, separators=3)
    group = shares(graph)
    with pytest.raises(BackendError, match="members must be sorted"):
        replace(group[0], members=(1, 0))
    with pytest.raises(BackendError, match="not in the group"):
        replace(group[0], members=(0,))
    with pytest.raises(BackendError, match="robust selection"):
        node_for(group[0], SolverConfig(method="sor", robust="gnc"))


@given(
    st.sampled_from(list(SolverStage)),
    st.integers(0, 100),
    st.integers(0, 60_000),
    st.integers(0, 4),
    st.floats(allow_nan=False, width=32),
)
def test_messages_survive_their_encoding(stage, sweep, robot, rows, number):
    round_ = Round(stage, 1, sweep)
    width = max(WIDTH[stage], 1)
    sent = (np.arange(rows * width, dtype=np.float64).reshape(rows, width) + number).astype(number_type(stage))
    values = Values(robot, 7, round_, sent.astype(np.float64))
    data = encode(values)
    back = decode(data)
    assert isinstance(back, Values) and back.round == round_ and np.array_equal(back.values, values.values)
    assert len(data) == 10 + values.payload_bytes
    for message in (
        Report(1, robot, round_, abs(number), 2.0, as_sent([0.1, sweep])),
        Decision(robot, 3, round_, True, number),
    ):
        assert decode(encode(message)) == message
        assert len(encode(message)) == 10 + message.payload_bytes
    with pytest.raises(BackendError, match="not a solver message"):
        decode(encode(Report(0, 1, round_, 1.0, 2.0))[:-3])
    with pytest.raises(BackendError, match="not a solver message"):
        decode(b"\x09" + data[1:10])


def test_steps_survive_their_encoding():
    steps = np.arange(-12, 12, dtype=np.int8).reshape(4, 6)
    message = Deltas(3, 4, Round(SolverStage.DESCENT, 2, 7), as_sent([0.1, 1e-9]), steps)
    back = decode(encode(message))
    assert isinstance(back, Deltas) and back.round == message.round and back.scales == message.scales
    assert np.array_equal(back.steps, steps) and len(encode(message)) == 10 + message.payload_bytes == 42
    with pytest.raises(BackendError, match="not a solver message"):
        decode(encode(message)[:-3])


@given(st.integers(0, 65_535), st.integers(0, 65_535), st.integers(0, 5), st.booleans())
def test_messages_without_rounds_survive_their_encoding(version, used, rows, quiet):
    at = Round(SolverStage.FREE)
    values = np.arange(6.0 * rows).reshape(rows, 6)
    state = SeparatorState(1, 2, at, version, used, values)
    back = decode(encode(state))
    assert isinstance(back, SeparatorState) and (back.version, back.used) == (version, used)
    assert np.array_equal(back.values, values) and len(encode(state)) == 14 + state.payload_bytes
    neighbours = tuple((n, version) for n in range(rows))
    status = Status(3, 1, at, (Standing(3, used, version, quiet, neighbours), Standing(7, 1, 0, True, ())))
    assert decode(encode(status)) == status and len(encode(status)) == 10 + status.payload_bytes
    with pytest.raises(BackendError, match="not a solver message"):
        decode(encode(status)[:-3])
