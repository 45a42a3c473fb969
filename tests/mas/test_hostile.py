"""What one hostile agent can do to its team: each kind of attack against the presets as they are. Every run comes to
its end and writes its files; the others are in one frame, about as exact as without the hostile agent, and think well
of each other."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import hostile
import numpy as np
import pytest
from factory import manifest_of
from hostile import Hostile
from test_odd_agents import error_m, four, honest, without

from maslam._replaced import replaced
from maslam.mas import simulation
from maslam.mas.agent import Agent
from maslam.mas.contracts.reputation import Trust
from maslam.mas.evaluation.ground_truth import GroundTruthEvaluator, groups_of
from maslam.mas.policies.presets import policy_of, preset
from maslam.mas.simulation import Environment

# Errors of the others, on average, over those without the hostile agent, or with it when it is not hostile: whichever
# is the nearer comparison, since other agents and other messages make other matches; so is a run in which it behaves
# and leaves after a while: who is found out is done without from then on.
WITHIN = 1.05


class _Play(Environment):
    """An environment that brings the raw bytes of a hostile agent as well."""

    played: list[Environment]

    def step(self, number: int) -> None:
        super().step(number)
        for agent in self.agents:
            if isinstance(agent, Hostile):
                for data in agent.raw():
                    for other in agent.others:
                        self.transport.carry(agent.state.me, other, data)
        self._deliver()


def attacked(
    monkeypatch: pytest.MonkeyPatch, out: Path, name: str, odd: int, kind: type[Agent] | None, leaves: bool = False
) -> tuple[Environment, list[float]]:
    """A whole run with its files; the others' errors."""
    sequences, kept = four(), []
    make = simulation.make_agents

    def make_agents(manifest, sequences, config, policy=None):  # type: ignore[no-untyped-def]
        agents = make(manifest, sequences, config, policy)
        if kind is not None:
            agents[odd] = kind(agents[odd].state.profile, config, policy_of(config, odd))
        return agents

    class Play(_Play):
        def __init__(self, *arguments) -> None:  # type: ignore[no-untyped-def]
            super().__init__(*arguments)
            kept.append(self)

    monkeypatch.setattr(simulation, "make_agents", make_agents)
    monkeypatch.setattr(simulation, "Environment", Play)
    config = preset(name)
    if leaves:
        config = replaced(config, faults=replaced(config.faults, leave_s={odd: 5.0}))
    simulation.run(manifest_of(sequences), sequences, config, out)
    assert (out / "summary.json").exists()
    environment, evaluator = kept[0], GroundTruthEvaluator(sequences)
    return environment, [error_m(environment, evaluator, a) for a in honest(odd)]


@cache
def peaceful(name: str, odd: int) -> list[float]:
    """The same without hostility."""
    import tempfile

    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
        return attacked(patch, Path(folder) / "run", name, odd, None)[1]


@cache
def left(name: str, odd: int) -> list[float]:
    """Without hostility, and without the agent after the first five seconds."""
    import tempfile

    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
        return attacked(patch, Path(folder) / "run", name, odd, None, leaves=True)[1]


# Each kind where it does most: as the directory, the lowest manager and the elected agent of ours, or among those who
# ask everybody and solve in sweeps.
ATTACKS = [
    ("maslam", 0, hostile.NamesStrangers),
    ("default", 2, hostile.SendsNested),
    ("default", 0, hostile.FarKeyframes),
    ("maslam", 0, hostile.SellsFarKeyframes),
    ("maslam", 2, hostile.WildDepth),
    ("selection", 0, hostile.WildWay),
    ("maslam", 2, hostile.WildQuery),
    ("default", 2, hostile.WildInformation),
    ("maslam", 2, hostile.FarDeadline),
    ("default", 0, hostile.NeverBegins),
    ("maslam", 0, hostile.FalseSolver),
    ("maslam", 0, hostile.BendingSolver),
    ("default", 0, hostile.NoisySolver),
    ("default", 2, hostile.NoisySolver),
    ("default", 2, hostile.RowTooMany),
    ("default", 2, hostile.BidsForOthers),
    ("maslam", 0, hostile.FalseDirectory),
    ("maslam", 2, hostile.SellsUnordered),
    ("maslam", 0, hostile.Spoofer),
    ("maslam", 0, hostile.SendsHeaps),
    ("selection", 2, hostile.WrongAnswers),
    ("maslam", 2, hostile.FitsTooWell),
]


@pytest.mark.parametrize(("name", "odd", "kind"), ATTACKS, ids=lambda v: getattr(v, "__name__", str(v)))
def test_one_hostile_agent_hurts_nobody(
    name: str, odd: int, kind: type[Agent], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    environment, errors = attacked(monkeypatch, tmp_path / "run", name, odd, kind)
    agents = environment.agents
    assert any(np.mean(errors) <= WITHIN * np.mean(calm(name, odd)) for calm in (without, peaceful, left)), errors
    assert any(set(honest(odd)) <= set(group) for group in groups_of(agents))
    for agent in honest(odd):
        assert all(agents[agent].context.reputation.trust(a) is Trust.GOOD for a in honest(odd))
        assert set(agents[agent].maps.copies) <= set(range(4)), "no map of an agent that there is not"
        assert not agents[agent].context.ledger.running()
