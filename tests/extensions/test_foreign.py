"""What becomes of a user's objects: each agent decides by itself, what is wrong is said, nothing stale is used."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from factory import town
from numpy.typing import NDArray

import maslam
from maslam.extensions import name_of
from maslam.mas.policies.directory import Directory
from maslam.mas.policies.presets import preset
from maslam.mas.simulation import run
from maslam.mas.transport.transport import InProcessTransport
from maslam.tools.report.summary_table import table_of


class Quiet(maslam.Policy):
    """Wants nothing, and remembers who it spoke for."""

    def __init__(self) -> None:
        self.spoke_for: set[int] = set()

    def ask(self, state: maslam.AgentState, outlook: maslam.Outlook, keyframe: int) -> list[int]:
        self.spoke_for.add(state.me)
        assert self.spoke_for == {state.me}, "an agent's policy is no other agent's"
        return []

    def optimise(self, state: maslam.AgentState, outlook: maslam.Outlook) -> list[int]:
        return []

    def buy(self, state: maslam.AgentState, outlook: maslam.Outlook) -> list[int]:
        return []


class Dreamer(Quiet):
    def ask(self, state: maslam.AgentState, outlook: maslam.Outlook, keyframe: int) -> list[int]:
        return [7]


class Vague(Quiet):
    def ask(self, state: maslam.AgentState, outlook: maslam.Outlook, keyframe: int) -> list[int]:
        return ["agent_01"]  # type: ignore[list-item]


class Speechless(Quiet):
    def ask(self, state: maslam.AgentState, outlook: maslam.Outlook, keyframe: int) -> list[int]:
        return None  # type: ignore[return-value]


class Absent(Quiet):
    def ask(self, state: maslam.AgentState, outlook: maslam.Outlook, keyframe: int) -> list[int]:
        return list(state.profile.others)

    def optimise(self, state: maslam.AgentState, outlook: maslam.Outlook) -> list[int]:
        return sorted(state.group - {state.me})


class Dizzy(Directory):
    def worth(self, reputation: float, benefit: float, bid: maslam.Bid, deadline_ns: int) -> float:
        return float("nan")


class Miser(Directory):
    def worth(self, reputation: float, benefit: float, bid: maslam.Bid, deadline_ns: int) -> float:
        return 0.0


def test_each_agent_has_a_policy_of_its_own(tmp_path: Path) -> None:
    given = Quiet()
    run(*town(3, 6), preset("maslam"), tmp_path / "object", policy=given)
    assert given.spoke_for == set()
    summary = json.loads((tmp_path / "object" / "summary.json").read_text())
    assert summary["policy"] == name_of(Quiet()) and f"with policy {summary['policy']}" in table_of(tmp_path / "object")
    run(*town(3, 6), preset("maslam"), tmp_path / "class", policy=Quiet)


@pytest.mark.parametrize(
    ("policy", "said"),
    [
        (Dreamer, r"Dreamer: ask\(\) named agent 7; it may name 0, 1, 2"),
        (Vague, r"Vague: ask\(\) gave \['agent_01'\]; numbers of agents are meant"),
        (Speechless, r"Speechless: ask\(\) gave None"),
        (Absent, r"Absent: optimise\(\) of agent \d leaves the agent itself out"),
        (Dizzy, r"Dizzy: worth\(\) gave nan"),
    ],
)
def test_an_answer_that_makes_no_sense_names_the_policy(policy: type[maslam.Policy], said: str, tmp_path: Path) -> None:
    with pytest.raises(maslam.MaslamError, match=said):
        run(*town(3, 20, spacing_m=7.0), preset("maslam"), tmp_path / "run", policy=policy)
    assert not (tmp_path / "run").exists()


def test_what_a_bid_is_worth_decides_who_sells(tmp_path: Path) -> None:
    material = town(3, 20, spacing_m=7.0)
    ours = run(*material, preset("maslam"), tmp_path / "ours", policy=Directory)
    poor = run(*material, preset("maslam"), tmp_path / "poor", policy=Miser())
    assert ours.map_copies and not poor.map_copies and poor.groups == ours.groups
    named = run(*material, preset("maslam"), tmp_path / "named")
    assert named.policy == "directory" and named == ours.model_copy(update={"policy": "directory"})


def test_a_transport_is_counted_anew_in_each_run(tmp_path: Path) -> None:
    transport = InProcessTransport()
    first = run(*town(2, 8, spacing_m=7.0), preset("maslam"), tmp_path / "first", transport=transport)
    again = run(*town(2, 8, spacing_m=7.0), preset("maslam"), tmp_path / "again", transport=transport)
    assert first == again and first.traffic["total"].messages > 0


def test_faults_are_made_on_top_of_a_users_transport(tmp_path: Path) -> None:
    config = preset("maslam")
    config = config.model_copy(update={"faults": config.faults.model_copy(update={"loss": 0.3})})
    lossy = run(*town(2, 8, spacing_m=7.0), config, tmp_path / "lossy", transport=InProcessTransport())
    assert lossy.faults is not None and lossy.faults.lost > 0


class Grey(maslam.Descriptor):
    """Mean grey levels of the upper and the lower half."""

    name = "grey"
    dim = 2
    threshold = 0.01

    def describe(self, images: Sequence[NDArray[np.uint8]] | NDArray[np.uint8]) -> NDArray[np.float32]:
        halves = [[float(half.mean()) + 1.0 for half in np.array_split(image, 2)] for image in images]
        rows = np.array(halves, dtype=np.float32).reshape(-1, 2)
        return rows / np.linalg.norm(rows, axis=1, keepdims=True)


class Turned(Grey):
    """The same name and size, another code."""

    def describe(self, images: Sequence[NDArray[np.uint8]] | NDArray[np.uint8]) -> NDArray[np.float32]:
        return super().describe(images)[:, ::-1]


class Long(Grey):
    def describe(self, images: Sequence[NDArray[np.uint8]] | NDArray[np.uint8]) -> NDArray[np.float32]:
        return 2 * super().describe(images)


class Wide(Grey):
    def describe(self, images: Sequence[NDArray[np.uint8]] | NDArray[np.uint8]) -> NDArray[np.float32]:
        return np.zeros((len(images), 3), dtype=np.float32)


def test_vectors_of_another_descriptor_are_made_anew(town_stereo: Path, tmp_path: Path) -> None:
    def vectors(descriptor: maslam.Descriptor, overwrite: bool = False) -> NDArray[np.float32]:
        sequences = maslam.preprocess(
            town_stereo / "agent_00", tmp_path / "seqs", descriptor=descriptor, overwrite=overwrite
        )
        assert sequences.manifest.descriptor.name == "grey"
        return sequences.read()[0].places.vectors

    first = vectors(Grey())
    stored = tmp_path / "seqs" / "frontend" / "agent_00.npz"
    made = stored.stat().st_mtime_ns
    np.testing.assert_array_equal(vectors(Grey()), first)
    assert stored.stat().st_mtime_ns == made, "used again"
    np.testing.assert_array_equal(vectors(Turned(), overwrite=True), first[:, ::-1])


@pytest.mark.parametrize(
    ("descriptor", "said"),
    [(Long, "descriptor grey: a vector has length 2, not 1"), (Wide, r"descriptor grey: made \(1, 3\) of 1 images")],
)
def test_a_vector_that_does_not_fit_names_the_descriptor(
    descriptor: type[maslam.Descriptor], said: str, town_stereo: Path, tmp_path: Path
) -> None:
    with pytest.raises(maslam.MaslamError, match=said):
        maslam.preprocess(town_stereo / "agent_00", tmp_path / "seqs", descriptor=descriptor)
