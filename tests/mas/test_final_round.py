"""The end of a run: news of maps travels along any chain of agents that have met, and nobody is asked in vain."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from factory import town

from maslam.mas.config import FaultsConfig, MasConfig
from maslam.mas.evaluation.summary import Summary
from maslam.mas.map_exchange.announcements import Announcements
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.messages import Offer
from maslam.mas.simulation import run

AGENTS = 8


def played(config: MasConfig, folder: Path) -> Summary:
    """Eight agents, each of which meets the next one at the very end of its way, and nobody else."""
    manifest, sequences = town(AGENTS, 22, spacing_m=21.0)
    summary = run(manifest, sequences, config, folder)
    with open(folder / "matches.csv", newline="") as file:
        met = {
            (int(r["query_agent"]), int(r["match_agent"])) for r in csv.DictReader(file) if r["outcome"] == "accepted"
        }
    assert all((a - b) % AGENTS in (1, AGENTS - 1) for a, b in met)
    assert summary.groups == [list(range(AGENTS))]
    return summary


def everyone_has(summary: Summary) -> set[tuple[int, int]]:
    return {(c.holder, c.owner) for c in summary.map_copies}


PAIRS = {(a, b) for a in range(AGENTS) for b in range(AGENTS) if a != b}


@pytest.mark.parametrize("name", ["maslam", "optimised"])
def test_maps_travel_down_a_chain(name: str, tmp_path: Path) -> None:
    summary = played(preset(name), tmp_path / "run")
    assert everyone_has(summary) == PAIRS


def test_every_copy_is_the_last_version(tmp_path: Path) -> None:
    summary = played(preset("maslam"), tmp_path / "run")
    newest = {o: max(c.version for c in summary.map_copies if c.owner == o) for o in range(AGENTS)}
    assert all(c.version == newest[c.owner] for c in summary.map_copies)


def test_they_travel_where_messages_get_lost(tmp_path: Path) -> None:
    config = preset("maslam").model_copy(update={"faults": FaultsConfig(loss=0.2)})
    assert everyone_has(played(config, tmp_path / "run")) == PAIRS


def test_nothing_travels_at_the_end_without_final_purchases(tmp_path: Path) -> None:
    config = preset("maslam")
    merge = config.merge.model_copy(update={"closing_rounds": 0})
    summary = played(config.model_copy(update={"merge": merge}), tmp_path / "run")
    assert everyone_has(summary) < PAIRS
    with open(tmp_path / "run" / "traffic.csv", newline="") as file:
        assert "MapNotice" not in {row["kind"] for row in csv.DictReader(file)}


def test_news_is_what_the_other_does_not_know() -> None:
    known = Announcements()
    offers = (Offer(0, 2, 10), Offer(1, 5, 10), Offer(2, 1, 10))
    assert known.new_for(2, offers) == offers[:2]  # its own map is no news to it
    known.known_to(2, [Offer(0, 2, 10), Offer(1, 4, 9)])
    assert known.new_for(2, offers) == (Offer(1, 5, 10),)
    known.known_to(2, offers)
    known.known_to(2, [Offer(1, 3, 8)])  # an older version makes it forget nothing
    assert known.new_for(2, offers) == () and known.new_for(3, offers) == offers
