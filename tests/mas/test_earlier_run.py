"""A run onto an earlier one: its agents answer, the later ones find themselves in its map and extend it."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from factory import circuit, make_sequence, make_world, manifest_of
from msgspec import structs
from test_sequence import write

from maslam.backend.trajectory_error import trajectory_error
from maslam.frontend.files.trajectory import read_tum
from maslam.mas.errors import MasError
from maslam.mas.evaluation.summary import Summary
from maslam.mas.manifest import Manifest, read_manifest
from maslam.mas.output.earlier_run import EarlierRun, joined_manifest, read_earlier_run
from maslam.mas.output.saved_agent import SAVED, restore, saved
from maslam.mas.policies.presets import preset
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import make_agents, run
from maslam.mas.state.keyframe import keyframes_of

WAY_M = 45.0


def agents(first_m: float, number: int, seed: int = 0) -> list[AgentSequence]:
    """Two agents 14 m apart, whose folders and recordings are called as those of any other two."""
    made = [make_sequence(make_world(seed), circuit(first_m + 14.0 * k, WAY_M), seed, number + k) for k in range(2)]
    return [replace(s, name=f"agent_{k:02d}", source=f"agent_{k:02d}", start_ns=0) for k, s in enumerate(made)]


@dataclass
class Runs:
    folder: Path
    later: list[AgentSequence]
    manifest: Manifest
    first: Summary
    second: Summary

    @property
    def one(self) -> Path:
        return self.folder / "one"

    @property
    def two(self) -> Path:
        return self.folder / "two"

    def earlier(self) -> EarlierRun:
        return read_earlier_run(self.one)


@pytest.fixture(scope="module", params=["maslam", "default"])
def runs(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Runs:
    folder = tmp_path_factory.mktemp("runs")
    config = preset(request.param)
    before, later = agents(0.0, 0), agents(20.0, 10)
    manifest = manifest_of(later).model_copy(update={"source": "another day"})
    for name, sequences in (("one", before), ("two", later)):
        (folder / name / "sequences").mkdir(parents=True)
        write(folder / name / "sequences", sequences)
    first = run(manifest_of(before), before, config, folder / "one")
    second = run(manifest, later, config, folder / "two", onto=read_earlier_run(folder / "one"))
    return Runs(folder, later, manifest, first, second)


def centres(out: Path, agent: int) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    """Key-frames of an agent in the files of a run, and where they truly were."""
    folder = out / f"agent_{agent:02d}"
    estimate, truth = read_tum(folder / "trajectory_keyframes.tum"), read_tum(folder / "groundtruth.tum")
    return estimate.centres, truth.centres[truth.nearest(estimate.stamps_ns, 10**6)]


def rmse(apart: np.ndarray) -> float:  # type: ignore[type-arg]
    return float(np.sqrt((apart**2).sum(axis=1).mean()))


def test_later_agents_stand_in_the_earlier_map(runs: Runs) -> None:
    """By the files alone: the earlier agents lay the map on the truth, and the later ones are where they truly were."""
    assert runs.second.groups == [[0, 1, 2, 3]] and runs.second.matches.false_accepted == 0
    found = runs.second.earlier
    assert found is not None and (found.agents, found.frame, found.in_frame) == (2, (0, 0), [2, 3])
    pairs = [centres(runs.two, a) for a in range(4)]
    estimate, truth = (np.concatenate([p[k] for p in pairs[:2]]) for k in range(2))
    laid = trajectory_error(estimate, truth, False).T_truth_estimate
    errors = [rmse(laid @ e - t) for e, t in pairs]
    np.testing.assert_allclose(errors, found.ate_rmse_m, rtol=1e-3)
    assert max(errors[2:]) < 0.01 * WAY_M


def test_the_figures_of_the_earlier_map_are_those_of_the_files(runs: Runs) -> None:
    found = runs.second.earlier
    assert found is not None and found.moved is not None
    before = [centres(runs.one, a) for a in range(2)]
    estimate, truth = (np.concatenate([p[k] for p in before]) for k in range(2))
    known = rmse(trajectory_error(estimate, truth, False).T_truth_estimate @ estimate - truth)
    assert np.sqrt(np.mean(np.square(found.before_rmse_m))) == pytest.approx(known, rel=1e-3)
    moved = [rmse(centres(runs.two, a)[0] - centres(runs.one, a)[0]) for a in range(2)]
    assert found.moved == pytest.approx(np.sqrt(np.mean(np.square(moved))), rel=1e-3)
    assert found.moved < 3 * known, "the origin is where it was"


def test_the_earlier_map_is_not_made_worse(tmp_path: Path) -> None:
    """On average: what later agents add bends a map by chance for better or worse in a single world."""
    before, now = [], []
    for seed in range(4):
        one, later = tmp_path / f"one{seed}", agents(20.0, 10, seed)
        (one / "sequences").mkdir(parents=True)
        first = agents(0.0, 0, seed)
        write(one / "sequences", first)
        run(manifest_of(first), first, preset("maslam"), one)
        manifest = manifest_of(later).model_copy(update={"source": "another day"})
        found = run(manifest, later, preset("maslam"), tmp_path / f"two{seed}", onto=read_earlier_run(one)).earlier
        assert found is not None and found.in_frame == [2, 3]
        before.append(np.sqrt(np.mean(np.square(found.before_rmse_m))))
        now.append(np.sqrt(np.mean(np.square(found.ate_rmse_m[:2]))))
    assert np.mean(now) < 1.05 * np.mean(before)


def test_the_earlier_agents_only_answer(runs: Runs) -> None:
    with open(runs.two / "traffic.csv", newline="") as file:
        sent = list(csv.DictReader(file))
    asked = {int(row["sender"]) for row in sent if row["kind"] in ("PlaceQuery", "OwnerQuery", "VerifyTask")}
    assert asked <= {2, 3}
    assert runs.second.duration_s == max(s.keyframe_stamps_ns[-1] for s in runs.later) / 1e9


def test_recordings_of_one_name_are_two(runs: Runs) -> None:
    """Their times are the same, too: nothing but the folders they came from tells them apart."""
    assert runs.second.matches.same_image == 0 and "same image" not in runs.second.matches.skipped
    assert runs.second.matches.between_agents > 4
    names = [one.sequence for one in runs.second.coverage]
    assert names == ["agent_00 of made up", "agent_01 of made up", "agent_00", "agent_01"]


def test_an_agent_is_restored_as_it_was(runs: Runs) -> None:
    earlier = runs.earlier()
    config = preset(runs.first.preset)
    for agent, sequence, known in zip(
        make_agents(earlier.manifest, earlier.sequences, config), earlier.sequences, earlier.known, strict=True
    ):
        restore(agent, keyframes_of(sequence), known, "it")
        again = saved(agent)
        assert again.matches.ids == known.matches.ids and again.used == known.used and again.group == known.group
        assert again.pieces == known.pieces and again.sent == known.sent and again.asked == known.asked
        np.testing.assert_allclose(again.places.array(), known.places.array(), atol=1e-12)
        np.testing.assert_array_equal(again.matches.information.array(), known.matches.information.array())
        assert [c.parcel.patches[-1].check for c in again.copies] == [c.parcel.patches[-1].check for c in known.copies]
        assert agent.state.accepted and not agent.pending.matches
        assert again.published == known.published, "the next version of its map counts on"
        told = agent.places.sent_queries.unsent(9)
        assert told == [k.index for k in agent.state.keyframes if k.textured], "as an agent that takes over is told"
        if config.merge.form == "compact":
            assert len(known.copies) == 1 and known.published is not None


def test_whom_an_agent_distrusted_it_distrusts_still(runs: Runs) -> None:
    earlier = runs.earlier()
    agent = make_agents(earlier.manifest, earlier.sequences, preset(runs.first.preset))[0]
    known = structs.replace(earlier.known[0], distrusted=(1,))
    restore(agent, keyframes_of(earlier.sequences[0]), known, "it")
    assert agent.state.distrusted == {1}
    assert any(m.match_agent == 1 for m in known.used), "which it used before, as the other had computed them"
    assert not any(m.match_agent == 1 for m in agent.state.accepted)


def test_a_third_run_goes_onto_the_second(runs: Runs) -> None:
    """Its folder has all that it takes; the first may be gone."""
    found = read_earlier_run(runs.two)
    assert [s.name for s in found.sequences] == [f"agent_{a:02d}" for a in range(4)]
    assert [e.source for e in found.manifest.agents] == ["made up"] * 2 + ["another day"] * 2
    assert [len(k.places.array()) for k in found.known] == [len(s.keyframe_stamps_ns) for s in found.sequences]
    assert read_manifest(runs.two / "earlier").agents == runs.earlier().manifest.agents


def test_what_does_not_go_together_is_refused(runs: Runs, tmp_path: Path) -> None:
    import shutil

    other = runs.manifest.descriptor.model_copy(update={"sha256": "cd" * 32})
    with pytest.raises(MasError, match="made with place descriptor"):
        joined_manifest(runs.earlier(), runs.manifest.model_copy(update={"descriptor": other}))
    far = runs.manifest.model_copy(update={"settings": {"gps": {"origin": [1.0, 2.0, 3.0]}}})
    here = replace(runs.earlier(), manifest=far.model_copy(update={"settings": {"gps": {"origin": [5.0, 2.0, 3.0]}}}))
    with pytest.raises(MasError, match="its positions count from"):
        joined_manifest(here, far)
    copied = tmp_path / "run"
    shutil.copytree(runs.one, copied)
    (copied / "agent_01" / SAVED).write_bytes((copied / "agent_01" / SAVED).read_bytes()[:-9])
    with pytest.raises(MasError, match=r"agent_01/agent\.msgpack: damaged"):
        read_earlier_run(copied)
    (copied / "agent_01" / SAVED).unlink()
    with pytest.raises(MasError, match="missing"):
        read_earlier_run(copied)
    shutil.rmtree(copied / "sequences")
    with pytest.raises(MasError, match="its agent sequences are not beside it: copy"):
        read_earlier_run(copied)
    shutil.copytree(runs.two / "earlier", copied / "sequences")
    shutil.copytree(runs.two / "sequences", copied / "earlier")
    with pytest.raises(MasError, match="not the agent sequences that the run was made of"):
        read_earlier_run(copied)
    with pytest.raises(MasError, match=r"no summary\.json"):
        read_earlier_run(tmp_path)


def test_another_agents_knowledge_is_refused(runs: Runs) -> None:
    earlier = runs.earlier()
    agent = make_agents(earlier.manifest, earlier.sequences, preset(runs.first.preset))[0]
    with pytest.raises(MasError, match="agent 1 with 30 key-frames, its sequence has 30"):
        restore(agent, keyframes_of(earlier.sequences[0]), earlier.known[1], "it")


def test_the_earlier_run_is_not_written_over(runs: Runs, capsys: pytest.CaptureFixture[str]) -> None:
    from maslam.tools import cli

    before = (runs.one / "summary.json").read_bytes()
    words = ["run", str(runs.two / "sequences"), str(runs.one), "--onto", str(runs.one), "--overwrite", "--quiet"]
    assert cli.main(words) == 2
    assert "is the folder for the results; choose another one" in capsys.readouterr().err
    assert (runs.one / "summary.json").read_bytes() == before
