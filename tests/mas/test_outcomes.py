"""What becomes of unusual runs: nobody met, tracking lost, one camera, look-alike places, lies, breaks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from by_hand import logged, sent
from factory import DIM, circuit, make_sequence, make_world, manifest_of, town
from sample_messages import examples, verify_task

from maslam.backend.trajectory_error import path_length
from maslam.frontend.files.trajectory import Trajectory, read_tum
from maslam.mas.errors import MasError
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import ContractId, MatchId, OperationKind
from maslam.mas.protocol.messages import Award, Begin, Call, Failure, Message, Result, encode
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import make_agents, run
from maslam.mas.transport.transport import InProcessTransport, RefusedMessage

DEFAULT = preset("default")


def test_an_agent_that_meets_nobody_keeps_its_own_map(tmp_path: Path) -> None:
    world = make_world(1)
    far = circuit(90.0, 24.0)
    sequences = [
        make_sequence(world, path, 1, a) for a, path in enumerate([circuit(0.0, 24.0), circuit(5.0, 24.0), far])
    ]
    summary = run(manifest_of(sequences), sequences, DEFAULT, tmp_path / "run")
    assert summary.groups == [[0, 1], [2]]
    assert not any(c.holder == 2 or c.owner == 2 for c in summary.map_copies)
    assert summary.ate_rmse_m.agents[2] == pytest.approx(summary.odometry_rmse_m[2], rel=0.05)
    assert summary.ate_rmse_m.connected[2] is not None
    assert len(read_tum(tmp_path / "run" / "agent_02" / "trajectory.tum")) == len(far)


def test_agents_of_unequal_length_and_one_that_saw_nothing(tmp_path: Path) -> None:
    world = make_world(6)
    paths = [circuit(0.0, 24.0), circuit(5.0, 12.0), circuit(90.0, 9.0)]
    sequences = [make_sequence(world, path, 6, a) for a, path in enumerate(paths)]
    empty = {
        "stamps_ns": np.zeros(0, np.int64),
        "vectors": np.zeros((0, DIM), np.float32),
        "textured": np.zeros(0, bool),
    }
    places = replace(sequences[2].places, **empty)
    nothing = Trajectory(np.zeros(0, np.int64), np.zeros((0, 4, 4)))
    sequences[2] = replace(sequences[2], tracks=(), places=places, trajectory=nothing)
    summary = run(manifest_of(sequences), sequences, DEFAULT, tmp_path / "run")
    assert summary.groups == [[0, 1], [2]]
    assert summary.keyframes_placed == [16, 8, 0]
    assert summary.ate_rmse_m.agents[2] is None and summary.exploration_percent[2] == 0.0
    assert (tmp_path / "run" / "agent_02" / "trajectory.tum").read_text() == ""


def test_one_agent_closes_its_own_loop(tmp_path: Path) -> None:
    world = make_world(2)
    config = DEFAULT.model_copy(update={"places": DEFAULT.places.model_copy(update={"own_age_keyframes": 40})})
    sequences = [make_sequence(world, circuit(0.0, 126.0, side_m=30.0, radius_m=6.0), 2, drifting=0.03)]
    summary = run(manifest_of(sequences), sequences, config, tmp_path / "run")
    assert summary.groups == [[0]]
    assert summary.matches.own_loops >= 2 and summary.matches.false_accepted == 0
    assert summary.optimisations.count >= 1
    assert summary.ate_rmse_m.agents[0] is not None and summary.odometry_rmse_m[0] is not None
    assert summary.ate_rmse_m.agents[0] < summary.odometry_rmse_m[0]
    assert summary.traffic["total"].messages == 0


def test_without_truth_there_are_no_errors_but_everything_else(tmp_path: Path) -> None:
    manifest, sequences = town(2, 14, spacing_m=5.0, with_truth=False)
    summary = run(manifest, sequences, DEFAULT, tmp_path / "run")
    assert summary.groups == [[0, 1]]
    assert summary.ate_rmse_m.agents == [None, None] and summary.ate_rmse_m.mean_maps is None
    assert summary.matches.false_accepted is None
    assert not (tmp_path / "run" / "agent_00" / "groundtruth.tum").exists()


def test_the_truth_does_not_reach_an_agent(tmp_path: Path) -> None:
    """Another truth changes the figures and nothing that an agent made."""
    manifest, sequences = town(2, 14, spacing_m=5.0)
    wrong = [replace(s, groundtruth=_elsewhere(s)) for s in sequences]
    for name, given in (("a", sequences), ("b", wrong)):
        run(manifest, given, DEFAULT, tmp_path / name)
    for file in ("agent_00/trajectory.tum", "agent_01/graph.g2o", "events.jsonl", "traffic.csv"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def _elsewhere(sequence: AgentSequence) -> Trajectory:
    assert sequence.groundtruth is not None
    rng = np.random.default_rng(9)
    poses = sequence.groundtruth.poses.copy()
    poses[:, :3, 3] += rng.normal(size=(len(poses), 3))
    return Trajectory(sequence.groundtruth.stamps_ns, poses)


def test_a_lost_track_is_joined_by_matches(tmp_path: Path) -> None:
    """Agent 1 loses tracking half-way; agent 0 drove all of its way, so matches place both tracks."""
    world = make_world(3)
    whole = make_sequence(world, circuit(0.0, 45.0), 3, 0)
    broken = make_sequence(world, circuit(0.0, 45.0), 3, 1, cuts=(45,))
    summary = run(manifest_of([whole, broken]), [whole, broken], DEFAULT, tmp_path / "run")
    assert len(broken.tracks) == 2
    assert summary.groups == [[0, 1]]
    assert summary.keyframes_placed[1] == 30
    assert summary.ate_rmse_m.connected[1] is not None and summary.ate_rmse_m.connected[1] < 0.5


def test_a_lost_track_that_nothing_joins_is_left_out_and_said_so(tmp_path: Path) -> None:
    way = np.concatenate([circuit(0.0, 30.0), circuit(90.0, 15.0)])  # it is carried to another street
    alone = [make_sequence(make_world(3), way, 3, 0, cuts=(60,))]
    summary = run(manifest_of(alone), alone, DEFAULT, tmp_path / "run")
    assert summary.keyframes == 30 and summary.keyframes_placed == [20]
    assert len(read_tum(tmp_path / "run" / "agent_00" / "trajectory.tum")) == 60


def test_monocular_agents_of_different_units_share_one_scale(tmp_path: Path) -> None:
    world = make_world(4)
    sequences = [
        make_sequence(world, circuit(0.0, 36.0), 4, 0, scale=0.5),
        make_sequence(world, circuit(6.0, 36.0), 4, 1, scale=0.2),
    ]
    summary = run(manifest_of(sequences), sequences, DEFAULT, tmp_path / "run")
    assert summary.scale == "arbitrary" and summary.groups == [[0, 1]]
    assert summary.matches.false_accepted == 0
    lengths = [path_length(read_tum(tmp_path / "run" / f"agent_0{a}" / "trajectory.tum").centres) for a in (0, 1)]
    assert lengths[1] == pytest.approx(lengths[0], rel=0.05), "one unit of length for both"
    connected = [e for e in summary.ate_rmse_m.connected if e is not None]
    assert len(connected) == 2 and max(connected) < 0.6


def test_places_that_only_look_alike_are_not_accepted(tmp_path: Path) -> None:
    """Two streets with the same place vectors and the same descriptors, whose points stand otherwise."""
    world = make_world(5)
    copied = np.random.default_rng(5).permutation(len(world.points))
    twin = replace(world, points=world.points[copied])
    sequences = [make_sequence(world, circuit(0.0, 30.0), 5, 0), make_sequence(twin, circuit(0.0, 30.0), 5, 1)]
    summary = run(manifest_of(sequences), sequences, DEFAULT, tmp_path / "run")
    assert summary.matches.candidates >= 10, "the places must look alike for this to mean anything"
    assert summary.matches.accepted == 0
    assert summary.groups == [[0], [1]]


def test_different_descriptor_models_do_not_go_together(tmp_path: Path) -> None:
    manifest, sequences = town(2, 4)
    other = replace(sequences[1], places=replace(sequences[1].places, sha256="cd" * 32))
    with pytest.raises(MasError, match="agent_01: place vectors of model"):
        run(manifest, [sequences[0], other], DEFAULT, tmp_path / "run")
    assert not list(tmp_path.iterdir())


def test_a_run_that_breaks_leaves_nothing(tmp_path: Path) -> None:
    manifest, sequences = town(2, 6)

    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(manifest, sequences, DEFAULT, tmp_path / "run", interrupt)
    assert not list(tmp_path.iterdir())


def test_a_folder_of_something_else_is_not_overwritten(tmp_path: Path) -> None:
    manifest, sequences = town(1, 4)
    (tmp_path / "thesis.doc").write_text("years of work")
    with pytest.raises(MasError, match="not an earlier run"):
        run(manifest, sequences, DEFAULT, tmp_path)
    assert (tmp_path / "thesis.doc").read_text() == "years of work"


def test_an_agent_refuses_what_makes_no_sense_and_lives_on() -> None:
    manifest, sequences = town(2, 4)
    agent = make_agents(manifest, sequences, DEFAULT)[1]
    for message in examples():
        if not isinstance(message.body, Award | Begin | Result) and message.contract is not None:
            continue
        sent(agent, agent.handle(message))
    strange = [
        Message(0, 1, ContractId(0, 0), Award(verify_task())),
        Message(0, 1, ContractId(0, 0), Begin()),
        Message(7, 1, ContractId(7, 0), Award(verify_task())),
        Message(0, 0, None, examples()[-1].body),
    ]
    before = len(logged(agent, "refused"))
    assert all(sent(agent, agent.handle(message)) == [] for message in strange)
    assert len(logged(agent, "refused")) == before + len(strange)
    assert not agent.state.accepted and not agent.maps.copies


def test_a_claim_about_a_key_frame_that_is_not_there_fails_politely() -> None:
    manifest, sequences = town(2, 4)
    agent = make_agents(manifest, sequences, DEFAULT)[1]
    contract = ContractId(0, 0)
    agent.handle(Message(0, 1, contract, Call(OperationKind.RELPOSE, 10**9)))
    effects = agent.handle(Message(0, 1, contract, Award(verify_task(match=MatchId(0, 3, 1, 99)))))
    assert [type(m.body) for m in effects.messages] == [Failure]
    assert not agent.context.ledger.running()


def test_corrupt_bytes_between_agents_cost_only_their_message() -> None:
    transport = InProcessTransport(2**20)
    good = encode(examples()[0])
    transport.carry(0, 1, good[:-3])
    transport.carry(0, 1, good)
    assert isinstance(transport.receive(), RefusedMessage)
    assert transport.receive() == examples()[0]
    assert transport.refused == 1
