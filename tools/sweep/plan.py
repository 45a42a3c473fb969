"""Plan of a sweep, and its cells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import Field, field_validator
from pydantic_core import PydanticCustomError

from maslam._settings import Settings
from maslam._suggestions import UNKNOWN_NAME, did_you_mean
from maslam.mas.policies.presets import PRESETS

from ..common.errors import UnknownName

THESIS_PRESETS = ("predecessor", "default", "optimised", "selection", "maslam")
"""The thesis's four systems, and ours."""
TOWN = "town"
"""The name of the sequence in which all agents drive through one rendered town from starting points of their own."""


class SweepPlan(Settings):
    """``sequences``: names of KITTI pose files, or ``town``. ``settings``: of every run, over the preset's own."""

    sequences: tuple[str, ...] = Field(("00",), description="KITTI sequences by number, or town")
    agents: tuple[int, ...] = Field((4,), description="agents that a sequence is cut into; a town has so many")
    presets: tuple[str, ...] = Field(("maslam",), description="presets to compare")
    seeds: tuple[int, ...] = Field((0,), description="seeds of the runs")
    overlap: int = Field(0, ge=0, description="key-frames that an agent takes from its neighbours; the thesis: 3")
    width: int = Field(620, ge=64, le=4096, description="pixels of rendered images")
    height: int = Field(188, ge=64, le=4096, description="pixels of rendered images")
    step: int = Field(1, ge=1, description="take every so many poses of a file")
    frames: int = Field(0, ge=0, description="poses taken of each file, frames of each agent in a town; 0: all, 300")
    town_agents: tuple[int, ...] = Field((10,), description="numbers of agents in the town")
    world_seed: int = Field(0, ge=0, description="of the rendered worlds")
    settings: dict[str, Any] = Field(default_factory=dict, description="settings of every run, by section")

    @field_validator("presets")
    @classmethod
    def _known(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            if name not in PRESETS:
                words = {"name": name, "hint": did_you_mean(name, PRESETS)}
                raise PydanticCustomError(UNKNOWN_NAME, "there is no preset '{name}'{hint}", words)
        return names

    def cells(self) -> Iterator[Cell]:
        """Every run, in the order in which the tables list them."""
        for sequence in self.sequences:
            for agents in self.agents_in(sequence):
                for name in self.presets:
                    for seed in self.seeds:
                        yield Cell(sequence, agents, name, seed)

    def agents_in(self, sequence: str) -> tuple[int, ...]:
        """Numbers of agents that a sequence is run with."""
        return self.town_agents if sequence == TOWN else self.agents


@dataclass(frozen=True, order=True)
class Cell:
    """One run."""

    sequence: str
    agents: int
    preset: str
    seed: int

    @property
    def material(self) -> str:
        """Names what it runs on: the same for all presets and seeds."""
        return f"{self.sequence}_{self.agents:03d}"

    @property
    def name(self) -> str:
        """Names the run's folder: no two cells have the same."""
        return f"{self.material}_{self.preset}_{self.seed}"


def experiment(name: str) -> SweepPlan:
    """A plan by name. ``thesis``: chapter 4, Tables 4.1 to 4.3 and the town; ``scaling``: time and bytes against the
    number of agents; ``quick``: to see everything once."""
    presets = tuple(p for p in THESIS_PRESETS if p in PRESETS)
    plans = {
        "thesis": SweepPlan(
            sequences=("00", "05", "08", TOWN),
            agents=(4, 10, 20),
            presets=presets,
            seeds=(0, 1, 2, 3, 4),
            overlap=3,
        ),
        "scaling": SweepPlan(sequences=("00",), agents=(2, 4, 10, 20, 50, 100), presets=("maslam",), seeds=(0,)),
        "quick": SweepPlan(sequences=("07",), agents=(2, 4), presets=presets, seeds=(0, 1), frames=400, step=2),
    }
    if name not in plans:
        raise UnknownName(f"--experiment {name}: there is no such plan{did_you_mean(name, plans)}")
    return plans[name]
