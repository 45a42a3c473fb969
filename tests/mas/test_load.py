"""Load of each agent: against the list of all messages and of all events."""

from __future__ import annotations

import csv
import json
from collections import Counter
from pathlib import Path

import pytest
from factory import town

from maslam.mas.policies.presets import preset
from maslam.mas.simulation import run


@pytest.mark.parametrize("name", ["maslam", "default"])
def test_load_is_that_of_the_messages_and_events(tmp_path: Path, name: str) -> None:
    manifest, sequences = town(3, 10, spacing_m=3.0)
    summary = run(manifest, sequences, preset(name), tmp_path)
    with open(tmp_path / "traffic.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    events = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text(encoding="utf-8").splitlines()]
    out, into, asked = Counter[int](), Counter[int](), Counter[int]()
    for row in rows:
        out[int(row["sender"])] += int(row["wire_bytes"])
        into[int(row["recipient"])] += int(row["wire_bytes"])
        asked[int(row["recipient"])] += row["kind"] == "OwnerQuery"
    assert [(one.bytes_out, one.bytes_in) for one in summary.load] == [(out[me], into[me]) for me in range(3)]
    assert [one.directory_turns for one in summary.load] == [asked[me] for me in range(3)]
    solved = sum(event["event"] in ("optimised", "updated") for event in events)
    turns = [one.solver_turns for one in summary.load]
    if name == "maslam":
        assert sum(turns) == solved > 0
        # One directory for all, and one agent solves what it was elected for.
        assert sum(one.directory_turns > 0 for one in summary.load) == 1
    else:
        assert turns == [0, 0, 0] and not any(asked.values())
    optimised = [event for event in events if event["event"] == "optimised"]
    assert optimised and all((event["solver"] in event["members"]) == (name == "maslam") for event in optimised)
