"""What was skipped at the end of a stretch that agents share is verified once all is seen, where odometry drifts."""

from __future__ import annotations

import csv
from itertools import pairwise
from pathlib import Path

import pytest
from factory import town

from maslam.mas.config import FaultsConfig
from maslam.mas.policies.presets import preset
from maslam.mas.simulation import run


def accepted(drifting: float, ends: bool, folder: Path, delay_s: float = 0.0) -> list[tuple[int, int]]:
    """Own key-frames of all accepted matches of two agents that drive one after the other."""
    config = preset("maslam").model_copy(update={"faults": FaultsConfig(delay_s=delay_s)})
    places = config.places.model_copy(update={"closing_ends": ends})
    manifest, sequences = town(2, 60, spacing_m=10.0, drifting=drifting)
    summary = run(manifest, sequences, config.model_copy(update={"places": places}), folder)
    assert summary.groups == [[0, 1]] and summary.matches.false_accepted == 0
    with open(folder / "matches.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["outcome"] == "accepted"]
    return sorted((int(row["query_keyframe"]), int(row["match_keyframe"])) for row in rows)


def widest(pairs: list[tuple[int, int]]) -> int:
    """The most key-frames between neighbouring matches, on the query's side."""
    queries = [query for query, _ in pairs]
    return max(b - a for a, b in pairwise(queries))


@pytest.fixture(scope="module")
def drifting(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, list[tuple[int, int]]]:
    return {ends: accepted(0.1, ends, tmp_path_factory.mktemp("drift") / "run") for ends in (False, True)}


def test_where_odometry_drifts_what_was_skipped_is_verified_at_the_end(
    drifting: dict[bool, list[tuple[int, int]]],
) -> None:
    before, after = drifting[False], drifting[True]
    assert set(before) < set(after)
    assert max(after) >= max(before)
    assert widest(after) < widest(before)


def test_no_two_say_the_same(drifting: dict[bool, list[tuple[int, int]]]) -> None:
    _apart(drifting[False], drifting[True])


def test_nor_do_they_where_answers_come_late(tmp_path: Path) -> None:
    """Ends are verified one after the other, however long that takes."""
    before, after = (accepted(0.1, ends, tmp_path / str(ends), delay_s=0.4) for ends in (False, True))
    assert set(before) < set(after)
    _apart(before, after)


def _apart(before: list[tuple[int, int]], after: list[tuple[int, int]]) -> None:
    for query, _ in set(after) - set(before):
        others = [q for q, _ in after if q != query]
        assert min(abs(query - q) for q in others) > 3


def test_good_odometry_needs_none_of_it(tmp_path: Path) -> None:
    without, with_ends = (accepted(0.001, ends, tmp_path / str(ends)) for ends in (False, True))
    assert len(with_ends) - len(without) <= 2
