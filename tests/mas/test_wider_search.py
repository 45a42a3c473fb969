"""Candidates beyond the strict distance while agents are not in one frame: they join, the bytes stay bounded."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factory import circuit, make_sequence, make_world, manifest_of, town

from maslam.backend.geometry import Sim3
from maslam.mas.config import MasConfig
from maslam.mas.contracts.contract import Contract
from maslam.mas.contracts.effects import Effects
from maslam.mas.manifest import Manifest
from maslam.mas.place_recognition.candidates import Candidate
from maslam.mas.place_recognition.verification import Verification
from maslam.mas.place_recognition.wider_search import _CLOSING
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import MatchId
from maslam.mas.protocol.tasks import VerifyAnswer
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import make_agents, run
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.state.place_match import Match, MatchEnd


def nothing_is_strict(manifest: Manifest) -> Manifest:
    """The same vectors under a descriptor whose strict distance none of them reaches."""
    entry = manifest.descriptor.model_copy(update={"threshold": 1.2, "strict_threshold": 1e-6})
    return manifest.model_copy(update={"descriptor": entry})


def widened(every: int | None) -> MasConfig:
    config = preset("maslam")
    return config.model_copy(update={"places": config.places.model_copy(update={"widen_keyframes": every})})


def verified_pairs(folder: Path) -> list[dict[str, str]]:
    with open(folder / "matches.csv", newline="") as file:
        return [row for row in csv.DictReader(file) if row["outcome"] != "skipped"]


def test_agents_that_strict_distances_keep_apart_join(tmp_path: Path) -> None:
    manifest, sequences = town(2, 40, spacing_m=10.0, drifting=0.01)
    apart = run(nothing_is_strict(manifest), sequences, widened(None), tmp_path / "apart")
    assert apart.groups == [[0], [1]] and not verified_pairs(tmp_path / "apart")
    joined = run(nothing_is_strict(manifest), sequences, widened(10), tmp_path / "joined")
    assert joined.groups == [[0, 1]] and joined.matches.false_accepted == 0
    assert joined.matches.accepted >= 2


def strangers() -> tuple[Manifest, list[AgentSequence]]:
    """Two agents in worlds of their own: nothing that they see is the same place."""
    sequences = [make_sequence(make_world(seed), circuit(0.0, 45.0), 0, seed) for seed in (0, 1)]
    return manifest_of(sequences), sequences


@pytest.mark.parametrize("every", [10, 30])
def test_the_search_is_bounded_and_finds_nothing_that_is_not_there(tmp_path: Path, every: int) -> None:
    manifest, sequences = strangers()
    entry = manifest.descriptor.model_copy(update={"threshold": 2.0, "strict_threshold": 1e-6})
    summary = run(manifest.model_copy(update={"descriptor": entry}), sequences, widened(every), tmp_path / "run")
    keyframes = len(sequences[1].keyframe_stamps_ns)
    checked = len(verified_pairs(tmp_path / "run"))
    assert 0 < checked <= 2 * (keyframes // every + _CLOSING), "both agents ask"
    assert summary.groups == [[0], [1]] and summary.matches.accepted == 0
    with open(tmp_path / "run" / "traffic.csv", encoding="utf-8", newline="") as file:
        bodies = [row for row in csv.DictReader(file) if row["operation"] == "relpose"]
    counted = summary.matches.wider_traffic
    asked = sum(row["kind"] == "VerifyTask" for row in bodies)
    assert counted.messages == 5 * asked > 0, "call, bid, award, confirmation and result of each"
    assert counted.payload_bytes == sum(int(row["payload_bytes"]) for row in bodies)
    assert counted.wire_bytes > sum(int(row["wire_bytes"]) for row in bodies)


def test_where_agents_join_by_strict_distances_nothing_wider_is_verified(tmp_path: Path) -> None:
    manifest, sequences = town(2, 40, spacing_m=10.0, drifting=0.01)
    without = run(manifest, sequences, widened(None), tmp_path / "without")
    with_it = run(manifest, sequences, widened(50), tmp_path / "with")
    assert without.groups == [[0, 1]]
    assert with_it.traffic["total"].wire_bytes == without.traffic["total"].wire_bytes
    assert with_it.matches.wider_traffic.messages == 0 < with_it.traffic["relpose"].messages


def test_a_match_that_stays_alone_has_its_neighbours_verified() -> None:
    """Not at once, as most find their support by themselves; then at most three pairs of the next key-frames."""
    manifest, sequences = town(2, 40)
    agent = make_agents(manifest, sequences, widened(1000))[0]
    state, search = agent.state, agent.places.wider
    for keyframe in keyframes_of(sequences[0])[:11]:
        state.observe(keyframe)
    end = MatchEnd(0, np.eye(4), 0.0)
    alone = MatchId(0, 10, 1, 4)
    alone_match = Match(alone, end, end, Sim3.identity(), np.eye(6), 30, 10.0)
    state.add_match(alone_match)
    agent.candidates.by_id[alone] = Candidate(alone, 0, 0.5)
    assert search.due(closing=False) == []
    for keyframe in keyframes_of(sequences[0])[11:22]:
        state.observe(keyframe)
    asked = []
    while due := search.due(closing=False):
        agent.candidates.propose(due[0])
        asked.append(due[0].id)
    assert len(asked) == 3 and len(set(asked)) == 3
    assert all(max(abs(m.query - 10), abs(m.match - 4)) == 1 and m.match <= 4 for m in asked), "5 may not exist"
    beside = replace(alone_match, id=asked[0])
    state.add_match(beside)
    assert state.accepted == {alone, asked[0]} and search.due(closing=True) == []


def test_neighbours_are_those_that_the_other_is_known_to_have() -> None:
    """At the end of its own sequence an agent meets the other's beginning: there the neighbours are the other's."""
    manifest, sequences = town(2, 40)
    agent = make_agents(manifest, sequences, widened(1000))[0]
    for keyframe in keyframes_of(sequences[0])[:11]:
        agent.state.observe(keyframe)
    end = MatchEnd(0, np.eye(4), 0.0)
    alone = MatchId(0, 10, 1, 0)
    agent.state.add_match(Match(alone, end, end, Sim3.identity(), np.eye(6), 30, 10.0))
    agent.candidates.by_id[alone] = Candidate(alone, 0, 0.5)

    def asked() -> list[MatchId]:
        found = []
        while due := agent.places.wider.due(closing=True):
            agent.candidates.propose(due[0])
            found.append(due[0].id)
        return found

    assert [(m.query, m.match) for m in asked()] == [(9, 0)]
    agent.candidates.noted_length(1, 2)
    assert {(m.query, m.match) for m in asked()} == {(10, 1), (9, 1)}


def test_an_agent_learns_how_many_key_frames_the_other_has(tmp_path: Path) -> None:
    """From the answers to its verifications; nobody tells it otherwise."""
    learnt: dict[tuple[int, int], int] = {}
    on_result = Verification.on_result

    def watched(self: Verification, contract: Contract, outcome: VerifyAnswer) -> Effects:
        effects = on_result(self, contract, outcome)
        learnt[self.state.me, outcome.match.match_agent] = self.candidates.lengths[outcome.match.match_agent]
        return effects

    manifest, sequences = town(2, 40, spacing_m=10.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Verification, "on_result", watched)
        run(manifest, sequences, widened(1000), tmp_path / "run")
    lengths = [len(s.keyframe_stamps_ns) for s in sequences]
    assert learnt and all(0 < count <= lengths[other] for (_, other), count in learnt.items())
