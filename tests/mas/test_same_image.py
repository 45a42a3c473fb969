"""Two agents that were given the same images: a pair of one image is no evidence, is marked and counted apart."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import pytest
from factory import circuit, make_sequence, make_world, manifest_of

from maslam.mas.config import MasConfig
from maslam.mas.policies.presets import PRESETS, preset
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import run
from maslam.tools.sweep.reference import make_reference

SHARED = 24  # frames that both agents were given


def neighbours(source: str | None = "drive") -> list[AgentSequence]:
    """One drive cut into two with shared frames in the middle; the second agent's clock starts at its first frame.
    ``source`` None: each filmed its own images, which are of the same places."""
    way = circuit(0.0, 42.0)
    parts = [(0, 54), (54 - SHARED, 84)]
    world = make_world(3)
    out = []
    for number, (first, last) in enumerate(parts):
        one = make_sequence(world, way[first:last], 3, number)
        own = {"start_ns": first * 100_000_000, "first_frame": first}
        out.append(replace(one, source=source or one.name, **own))  # type: ignore[arg-type]
    return out


def rows(folder: Path) -> list[dict[str, str]]:
    with open(folder / "matches.csv", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("name", PRESETS)
def test_pairs_of_one_image_are_no_evidence(name: str, tmp_path: Path) -> None:
    sequences = neighbours()
    config = preset(name)  # in a code that the made-up vectors are long enough for
    config = config.model_copy(update={"places": config.places.model_copy(update={"code": "float32"})})
    summary = run(manifest_of(sequences), sequences, config, tmp_path / "run")
    written = rows(tmp_path / "run")
    same = [r for r in written if r["query_stamp_ns"] == r["match_stamp_ns"]]
    assert summary.matches.same_image == len(same) >= 3
    assert {r["outcome"] for r in same} == {"skipped"} and [r["same_image"] == "1" for r in written].count(True) == len(
        same
    )
    reasons = [r["reason"] for r in written]
    assert 3 <= reasons.count("same image") == summary.matches.skipped["same image"] <= len(same)
    assert not any(r["reason"] == "same image" or r["same_image"] == "1" for r in written if r not in same)
    counted = summary.matches.accepted, *summary.matches.rejected.values(), *summary.matches.skipped.values()
    assert sum(counted) == summary.matches.candidates


def test_images_of_ones_own_are_evidence(tmp_path: Path) -> None:
    """The same places at the same stamps, in recordings of their own."""
    sequences = neighbours(None)
    summary = run(manifest_of(sequences), sequences, _all_pairs(), tmp_path / "run")
    assert any(r["query_stamp_ns"] == r["match_stamp_ns"] for r in rows(tmp_path / "run"))
    assert summary.matches.same_image == 0 and summary.groups == [[0, 1]]


def test_stamps_that_went_through_text_still_name_one_image(tmp_path: Path) -> None:
    first, second = neighbours()
    sequences = [first, replace(second, start_ns=second.start_ns + 400)]
    summary = run(manifest_of(sequences), sequences, _all_pairs(), tmp_path / "run")
    assert summary.matches.same_image >= 3


def test_the_reference_does_not_use_them_either() -> None:
    own, shared = neighbours(None), neighbours()
    assert make_reference(manifest_of(own), own, preset("maslam")).matches > 0
    found = make_reference(manifest_of(shared), shared, preset("maslam"))
    assert found.candidates > 0 and found.matches == 0 and found.groups == [[0], [1]]


def _all_pairs() -> MasConfig:
    config = preset("default")
    return config.model_copy(update={"places": config.places.model_copy(update={"gap_keyframes": 0, "gap_m": 0.0})})
