"""Clustered place recognition: the owner of a cluster knows whose key-frame is nearest, and one query is enough."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from by_hand import handled, logged, ticked
from factory import DIM, MODEL, SHA256, town

from maslam.descriptors.container import PlaceVectors
from maslam.mas.agent import Agent
from maslam.mas.config import MasConfig
from maslam.mas.errors import MasError
from maslam.mas.place_recognition.peer_queries import ClusterIndex, LoggedPlace
from maslam.mas.policies.cluster_owners import centres_of, owner_of
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import OperationKind
from maslam.mas.protocol.messages import Award, Call, Confirmation, Message, Result
from maslam.mas.protocol.tasks import OwnerQuery, PlaceRedirect
from maslam.mas.simulation import make_agents, run
from maslam.mas.state.keyframe import keyframes_of


def of_preset(name: str, code: str = "float32", **places: object) -> MasConfig:
    """A preset for the made-up vectors, which are shorter than the predecessor's 128 numbers."""
    config = preset(name)
    return config.model_copy(update={"places": config.places.model_copy(update={"code": code, **places})})


def agents_of(count: int, keyframes: int, spacing_m: float = 3.0) -> list[Agent]:
    manifest, sequences = town(count, keyframes, spacing_m=spacing_m)
    return make_agents(manifest, sequences, of_preset("predecessor"))


def play(agents: list[Agent], keyframes: int) -> list[Message]:
    """Give all agents their key-frames one after the other, deliver everything; returns all that was said."""
    _, sequences = town(len(agents), keyframes, spacing_m=3.0)
    said: list[Message] = []
    for k in range(keyframes):
        for agent, sequence in zip(agents, sequences, strict=True):
            agent.observe(keyframes_of(sequence)[k])
            mail = ticked(agent, k * 10**9)
            while mail:
                message = mail.pop(0)
                said.append(message)
                mail += handled(agents, message)
    return said


def test_each_vector_goes_to_the_owner_of_the_nearest_centre() -> None:
    agents = agents_of(4, 8)
    said = play(agents, 8)
    asked = [(m.sender, m.recipient, m.body.task) for m in said if isinstance(m.body, Award)]
    queries = {(s, t.keyframe): r for s, r, t in asked if isinstance(t, OwnerQuery)}
    centres = agents[0].state.profile.centres
    assert centres is not None and centres.shape == (4, DIM)
    for agent in agents:
        np.testing.assert_array_equal(agent.state.profile.centres, centres)
        for keyframe in agent.state.keyframes:
            owner = int(np.argmin(((centres - keyframe.vector) ** 2).sum(axis=1)))
            # Own clusters need no message.
            assert queries.get((agent.state.me, keyframe.index), agent.state.me) == owner


def test_the_owner_names_the_nearest_that_it_was_asked_about_whoever_has_it() -> None:
    agents = agents_of(4, 8)
    said = play(agents, 8)
    centres = agents[0].state.profile.centres
    vectors = {(a.state.me, k.index): k.vector for a in agents for k in a.state.keyframes}
    order = [(a.state.me, k) for k in range(8) for a in agents]
    tasks = {
        m.contract: (m.sender, m.body.task.keyframe)
        for m in said
        if isinstance(m.body, Award) and isinstance(m.body.task, OwnerQuery)
    }
    redirected = 0
    for message in said:
        if not isinstance(message.body, Result) or not isinstance(message.body.outcome, PlaceRedirect):
            continue
        answer, asker = message.body.outcome, tasks[message.contract]
        earlier = order[: order.index(asker)]
        inside = [e for e in earlier if e[0] != asker[0] and owner_of(vectors[e], centres) == message.sender]
        if not inside:
            assert answer.agent is None
            continue
        apart = [float(np.linalg.norm(vectors[e] - vectors[asker])) for e in inside]
        assert (answer.agent, answer.keyframe) == inside[int(np.argmin(apart))]
        assert answer.distance == pytest.approx(min(apart), abs=1e-6)
        redirected += answer.agent != message.sender
    assert redirected > 3


def test_a_redirected_match_is_verified_with_the_agent_that_has_the_key_frame() -> None:
    agents = agents_of(4, 8)
    said = play(agents, 8)
    wanted = {m.recipient for m in said if isinstance(m.body, Call) and m.body.operation is OperationKind.RELPOSE}
    book = [c for a in agents for c in a.candidates.by_id.values()]
    third = [c for c in book if c.check.verified and owner_of_candidate(agents, c.id) not in c.id.agents]
    assert third and {c.id.match_agent for c in third} <= wanted
    assert not any(logged(a, "refused") for a in agents)


def owner_of_candidate(agents: list[Agent], match: object) -> int:
    vector = agents[match.query_agent].state.keyframes[match.query].vector  # type: ignore[attr-defined]
    return owner_of(vector, agents[0].state.profile.centres)


def test_clusters_send_an_eighth_of_query_all_at_most(tmp_path: Path) -> None:
    manifest, sequences = town(10, 30, spacing_m=14.0)
    # No distance is below this threshold: nothing but place recognition happens.
    runs = {n: run(manifest, sequences, of_preset(n, threshold=1e-6), tmp_path / n) for n in ("default", "predecessor")}
    everyone, owners = (runs[n].traffic["dvpr"] for n in ("default", "predecessor"))
    assert everyone.payload_bytes == 10 * 30 * 9 * (4 * DIM + 12)
    with open(tmp_path / "predecessor" / "traffic.csv", newline="") as file:
        kinds = [row["kind"] for row in csv.DictReader(file)]
    queries, answers = kinds.count("OwnerQuery"), kinds.count("PlaceRedirect")
    assert queries == answers and 0.7 * 300 < queries < 300
    assert owners.payload_bytes == queries * (4 * DIM + 5) + answers * 13
    assert 8 * owners.payload_bytes <= everyone.payload_bytes
    assert 8 * owners.wire_bytes <= everyone.wire_bytes


def first_award(agents: list[Agent]) -> Message:
    """The first owner query of all, undelivered."""
    _, sequences = town(len(agents), 8, spacing_m=3.0)
    for agent, sequence in zip(agents, sequences, strict=True):
        for keyframe in keyframes_of(sequence):
            agent.observe(keyframe)
    mail = [m for agent in agents for m in ticked(agent, 0)]
    while mail:
        message = mail.pop(0)
        if isinstance(message.body, Award) and isinstance(message.body.task, OwnerQuery):
            return message
        mail += handled(agents, message)
    raise AssertionError("nothing was asked")


def test_a_redirect_to_nobody_who_can_be_asked_is_refused() -> None:
    agents = agents_of(3, 8)
    award = first_award(agents)
    asker = agents[award.sender]
    for body in (Confirmation(), Result(PlaceRedirect(7, 0, 0.1))):
        mail = handled(agents, Message(award.recipient, award.sender, award.contract, body))
        assert not any(isinstance(m.body, Call) and m.body.operation is OperationKind.RELPOSE for m in mail)
    assert [e["reason"] for e in logged(asker, "refused")] == ["redirected to agent 7, which cannot be asked"]


def test_a_log_leaves_the_askers_own_key_frames_out() -> None:
    log = ClusterIndex()
    x, y = np.eye(4, dtype=np.float32)[:2]
    assert log.nearest(x, 0) is None
    log.remember(0, 5, x)
    log.remember(0, 5, y)
    assert log.nearest(x, 0) is None
    assert log.nearest(x, 1) == LoggedPlace(0, 5, 0.0)
    log.remember(1, 2, y)
    assert log.nearest(x, 0) == LoggedPlace(1, 2, pytest.approx(np.sqrt(2.0)))
    log.remember(2, 0, x)
    assert log.nearest(x, 1) == LoggedPlace(0, 5, 0.0)


def test_centres_come_from_other_images_where_the_settings_name_some(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(60, DIM)).astype(np.float32)
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    places = PlaceVectors(MODEL, SHA256, DIM, np.arange(60), rows, np.ones(60, dtype=bool))
    places.save(tmp_path / "netvlad.npz")
    manifest, sequences = town(3, 4)
    config = of_preset("predecessor", centres_from=str(tmp_path / "netvlad.npz"))
    centres = make_agents(manifest, sequences, config)[0].state.profile.centres
    np.testing.assert_array_equal(centres, centres_of(rows, 3, np.random.default_rng([0, 3])))
    PlaceVectors("other", "cd" * 32, DIM, np.arange(60), rows, np.ones(60, dtype=bool)).save(tmp_path / "other.npz")
    with pytest.raises(MasError, match=r"centres_from: .*other\.npz is of model other"):
        make_agents(manifest, sequences, of_preset("predecessor", centres_from=str(tmp_path / "other.npz")))
    with pytest.raises(MasError, match=r"centres_from: .*nothing\.npz"):
        make_agents(manifest, sequences, of_preset("predecessor", centres_from=str(tmp_path / "nothing.npz")))


def test_too_few_vectors_for_so_many_owners() -> None:
    with pytest.raises(MasError, match="5 agents need as many vectors at least, got 3"):
        centres_of(np.eye(3, dtype=np.float32), 5, np.random.default_rng(0))
