"""One agent of three sells a wrong map: the others reject it, say why, and go on without it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from factory import town

from maslam.mas.map_exchange.coding.quantised_map import QuantisedMap
from maslam.mas.map_exchange.publisher import Publisher
from maslam.mas.output.run_folder import Recorder
from maslam.mas.policies.presets import preset
from maslam.mas.simulation import Environment, make_agents
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.transport.transport import InProcessTransport

LIAR = 1


class LyingPublisher(Publisher):
    """Sells a map nine times as large as what its agent knows."""

    def _wanted(self, placed: list[int], base: QuantisedMap | None) -> QuantisedMap:
        true = super()._wanted(placed, base)
        return replace(true, poses=true.poses * np.array([9, 9, 9, 1, 1, 1]))


def test_a_wrong_map_is_kept_by_nobody_and_the_reason_is_on_record(tmp_path: Path) -> None:
    manifest, sequences = town(3, 30, spacing_m=14.0, drifting=0.01)
    config = preset("maslam")
    agents = make_agents(manifest, sequences, config)
    agents[LIAR].maps.seller._publisher = LyingPublisher(agents[LIAR].state)
    keyframes = [keyframes_of(s) for s in sequences]
    with Recorder(tmp_path / "run") as recorder:
        environment = Environment(agents, keyframes, InProcessTransport(2**24, recorder.sent), config)
        for number in range(environment.steps + 60):
            environment.step(number)
            if number >= environment.steps and environment.over:
                break
        assert environment.over
        recorder.events(environment.events)
    assert [sorted(a.maps.copies) for a in agents] == [[2], [0, 2], [0]]
    events = [json.loads(line) for line in (tmp_path / "run" / "events.jsonl").read_text().splitlines()]
    refused = [e for e in events if e["event"] == "map_refused"]
    assert {e["agent"] for e in refused} == {0, 2}
    assert {(e["owner"], e["reason"].partition(":")[0]) for e in refused} == {(LIAR, "no place match agrees")}
