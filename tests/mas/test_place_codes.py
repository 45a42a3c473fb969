"""Place vectors on the wire: agents decide as before, for fewer bytes, and refuse what they cannot read."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from by_hand import handled, logged, ticked
from factory import DIM, SHA256, talkative, town

from maslam.descriptors.codebooks import train_codebooks
from maslam.mas.agent import Agent
from maslam.mas.config import AUTO_CODE, MasConfig
from maslam.mas.errors import MasError
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.messages import Award, Failure, Message, Result
from maslam.mas.protocol.tasks import PlaceQuery
from maslam.mas.simulation import coder_of, make_agents, run
from maslam.mas.state.keyframe import keyframes_of


def with_code(code: str) -> MasConfig:
    return talkative(code=code)


def candidates(run_folder: Path) -> list[tuple[str, ...]]:
    with open(run_folder / "matches.csv", newline="") as file:
        names = ("query_agent", "query_keyframe", "match_agent", "match_keyframe", "outcome")
        return [tuple(row[n] for n in names) for row in csv.DictReader(file)]


def agents_with(code: str) -> list[Agent]:
    """Two agents that have seen the same street."""
    manifest, sequences = town(2, 14, spacing_m=0.0)
    agents = make_agents(manifest, sequences, with_code(code))
    for agent, sequence in zip(agents, sequences, strict=True):
        for keyframe in keyframes_of(sequence):
            agent.observe(keyframe)
    return agents


def asked(agents: list[Agent]) -> Message:
    """Agent 0's award with its first place query, everything before it delivered."""
    mail = ticked(agents[0], 0)
    while mail:
        message = mail.pop(0)
        if isinstance(message.body, Award) and isinstance(message.body.task, PlaceQuery):
            return message
        mail += handled(agents, message)
    raise AssertionError("nothing was asked")


def test_int8_decides_as_float32_does_for_a_quarter_of_the_bytes(tmp_path: Path) -> None:
    manifest, sequences = town(3, 24, spacing_m=14.0, drifting=0.03)
    runs = {code: run(manifest, sequences, with_code(code), tmp_path / code) for code in ("float32", "int8")}
    assert candidates(tmp_path / "int8") == candidates(tmp_path / "float32")
    fine, coarse = runs["float32"].traffic["dvpr"], runs["int8"].traffic["dvpr"]
    queries = fine.messages // 2
    assert fine.messages == coarse.messages and queries > 0
    assert fine.payload_bytes == queries * (4 * DIM + 12)
    assert coarse.payload_bytes == queries * (DIM + 12)
    assert coarse.wire_bytes < fine.wire_bytes - 2 * DIM * queries
    assert (runs["int8"].place_code, runs["int8"].place_code_bytes) == ("int8", DIM)


@pytest.mark.parametrize("code", ["float32", "int8", "int4", "float32x16", "int8x16"])
def test_the_answer_is_the_nearest_to_what_was_sent(code: str) -> None:
    agents = agents_with(code)
    award = asked(agents)
    query = award.body.task
    coder = agents[1].state.profile.coder
    assert len(query.vector) == coder.bytes and query.language == agents[1].state.profile.language
    sent = coder.decode(np.frombuffer(query.vector, dtype=np.uint8)[None])[0]
    own = coder.cut(np.array([k.vector for k in agents[1].state.keyframes]))
    apart = np.linalg.norm(own - sent, axis=1)
    (outcome,) = [m.body.outcome for m in handled(agents, award) if isinstance(m.body, Result)]
    assert outcome.keyframe == int(np.argmin(apart))
    assert outcome.distance == pytest.approx(float(apart.min()), abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"language": 0xEF}, "of another model or in another code (000000ef), mine is int8 of "),
        ({"vector": bytes([1] * (DIM - 1))}, f"int8 has {DIM} bytes, got"),
        ({"vector": bytes(DIM)}, "no direction"),
    ],
)
def test_a_query_that_cannot_be_read_fails_with_its_reason(changes: dict[str, object], reason: str) -> None:
    agents = agents_with("int8")
    award = asked(agents)
    task = award.body.task
    fields = {name: getattr(task, name) for name in task.__struct_fields__} | changes
    changed = Message(award.sender, award.recipient, award.contract, Award(PlaceQuery(**fields)))
    (said,) = [m.body for m in handled(agents, changed) if isinstance(m.body, Failure | Result)]
    assert isinstance(said, Failure) and reason in said.reason
    assert not logged(agents[1], "refused")


def test_another_model_or_code_is_another_language() -> None:
    mine = agents_with("int8")[0].state.profile
    others = [agents_with("float32")[0].state.profile, replace(mine, model="ef" * 32)]
    assert len({p.language for p in (mine, *others)}) == 3
    assert agents_with("int8")[1].state.profile.language == mine.language


def test_product_codes_use_the_books_beside_the_model(tmp_path: Path) -> None:
    manifest, sequences = town(2, 20, spacing_m=5.0)
    model = tmp_path / "made-up.onnx"
    manifest = manifest.model_copy(update={"settings": {"model": str(model)}})
    with pytest.raises(MasError, match=r"pq32 needs codebooks.*maslam netvlad codes .*made-up\.onnx, or choose"):
        run(manifest, sequences, with_code("pq32"), tmp_path / "run")
    rng = np.random.default_rng(0)
    vectors = np.concatenate([s.places.vectors for s in sequences])
    more = np.concatenate([vectors + 0.1 * rng.normal(size=vectors.shape) for _ in range(10)])
    more = (more / np.linalg.norm(more, axis=1, keepdims=True)).astype(np.float32)
    train_codebooks(more, SHA256, "made up").save(model.with_suffix(".codes.npz"))
    summary = run(manifest, sequences, with_code("pq32"), tmp_path / "run")
    assert summary.place_code.startswith("pq32-") and summary.place_code_bytes == 32
    assert summary.groups == [[0, 1]] and summary.matches.false_accepted == 0
    dvpr = summary.traffic["dvpr"]
    assert dvpr.payload_bytes == dvpr.messages // 2 * (32 + 12)


def test_an_unknown_code_is_one_line(tmp_path: Path) -> None:
    manifest, sequences = town(2, 4)
    with pytest.raises(MasError, match=r"no place code 'zip'; there are float32, "):
        run(manifest, sequences, with_code("zip"), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_the_thesis_system_sends_what_the_thesis_counts() -> None:
    assert preset("default").places.code == "float32"


@pytest.mark.parametrize("books", [True, False])
def test_auto_is_the_shortest_code_that_the_model_has_books_for(tmp_path: Path, books: bool) -> None:
    manifest, _ = town(2, 4)
    model = tmp_path / "made-up.onnx"
    manifest = manifest.model_copy(update={"settings": {"model": str(model)}})
    if books:
        vectors = np.random.default_rng(0).normal(size=(400, DIM)).astype(np.float32)
        unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        train_codebooks(unit, SHA256, "made up").save(model.with_suffix(".codes.npz"))
    assert coder_of(manifest, AUTO_CODE).code == ("pq32" if books else "int8")
