"""Figures of a sweep in the manner of the thesis's: 4.7 and 4.8 (bytes and exploration against agents), 4.2 (error over
time), 3.2, 3.3, 4.3 to 4.6, 4.10 and 4.11 (all trajectories, and each agent's maps), time against agents, regret."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..common.figures import dress, plain_powers, saved_figure
from ..common.plane import plane_of
from ..common.svg import FAINT, INK, colour_of
from ..report.charts import TRUTH
from ..report.run_data import read_run
from .rows import Group

_OPERATIONS = ("dvpr", "relpose", "dopt", "mapmerge", "negotiation")
_COLOURS = {"dvpr": "#0072B2", "relpose": "#E69F00", "dopt": "#009E73", "mapmerge": "#CC79A7", "negotiation": "#8d99a6"}
_SHOWN_AGENTS = 10


def draw_all(groups: Sequence[Group], runs: dict[tuple[str, int, str], Path], out: Path) -> list[Path]:
    """Every figure there is something for, under ``out``."""
    made = []
    for sequence in dict.fromkeys(group.sequence for group in groups):
        chosen = [group for group in groups if group.sequence == sequence]
        made.append(_against_agents(chosen, sequence, out / f"agents_{sequence}.png"))
    if any(group["regret_ate"] is not None for group in groups):
        made.append(_regret(groups, out / "regret.png"))
    for (sequence, agents, preset), run in runs.items():
        stem = f"{sequence}_{agents:03d}_{preset}"
        made.append(_trajectories(run, f"{sequence}, {agents} agents, {preset}", out / f"map_{stem}.png"))
        made.append(_over_time(run, f"{sequence}, {agents} agents, {preset}", out / f"time_{stem}.png"))
    return made


def _against_agents(groups: Sequence[Group], sequence: str, path: Path) -> Path:
    """Bytes, exploration, error and time against the number of agents, a colour a preset. Bytes and times of presets
    differ by powers of ten."""
    presets = list(dict.fromkeys(group.preset for group in groups))
    panels = [
        ("MB on the wire", "wire_total", True),
        ("explored, %", "explored", False),
        ("mean ATE, m", "ate_agents", False),
        ("s of the multi-agent part", "wall_s", True),
    ]
    numbers = sorted({group.agents for group in groups})
    with saved_figure(path, (13.0, 3.6)) as figure:
        for k, (label, name, powers) in enumerate(panels):
            axes = figure.add_subplot(1, len(panels), k + 1)
            for number, preset in enumerate(presets):
                rows = [(g.agents, g[name]) for g in groups if g.preset == preset]
                known = sorted((a, s.mean, s.half) for a, s in rows if s is not None)
                if known:
                    x, y, half = map(np.array, zip(*known, strict=True))
                    colour = colour_of(number)
                    axes.errorbar(x, y, half, marker="o", ms=4, lw=1.6, capsize=2, color=colour, label=preset)
            axes.set_xscale("log")
            axes.set_xticks(numbers, labels=[str(number) for number in numbers])
            axes.set_xticks([], minor=True)
            if powers:
                axes.set_yscale("log")
                plain_powers(axes.yaxis)
            else:
                axes.set_ylim(bottom=0)
            dress(axes, "", "agents", label)
        figure.axes[0].legend(frameon=False, fontsize=8)
        figure.suptitle(f"KITTI {sequence}" if sequence.isdigit() else sequence, x=0.01, ha="left", color=INK)
    return path


def _regret(groups: Sequence[Group], path: Path) -> Path:
    """Error over the reference's against bytes over the reference's: down and left is better."""
    presets = list(dict.fromkeys(group.preset for group in groups))
    with saved_figure(path, (6.4, 4.6)) as figure:
        axes = figure.add_subplot()
        for number, preset in enumerate(presets):
            chosen = [g for g in groups if g.preset == preset and g["regret_ate"] is not None]
            x, y = ([g[name].mean for g in chosen] for name in ("regret_bytes", "regret_ate"))  # type: ignore[union-attr]
            axes.plot(x, y, "o", ms=6, color=colour_of(number), label=preset, alpha=0.85)
        axes.axhline(1.0, color=FAINT, lw=1)
        axes.set_xscale("log")
        plain_powers(axes.xaxis)
        axes.set_ylim(0.0, 1.05 * axes.get_ylim()[1])
        axes.legend(frameon=False)
        dress(axes, "", "bytes over the reference's", "mean ATE over the reference's")
    return path


def _trajectories(run: Path, title: str, path: Path) -> Path:
    """All trajectories over the truth, then each agent's own map with the copies it holds."""
    data = read_run(run)
    truths = [agent.truth.centres for agent in data.agents if agent.truth is not None]
    a, b = plane_of(np.concatenate(truths or list(data.in_world)))
    shown = data.agents[:_SHOWN_AGENTS]
    columns = 2 + -(-len(shown) // 2)
    with saved_figure(path, (2.2 * columns, 4.6)) as figure:
        grid = figure.add_gridspec(2, columns)
        whole = figure.add_subplot(grid[:, :2])
        _paths(whole, data, range(len(data.agents)), (a, b))
        whole.set_title(title, loc="left", fontsize=10, color=INK)
        copies = {(c["holder"], c["owner"]) for c in data.summary["map_copies"]}
        for agent in shown:
            axes = figure.add_subplot(grid[agent.index % 2, 2 + agent.index // 2])
            held = [k for k in range(len(data.agents)) if k == agent.index or (agent.index, k) in copies]
            _paths(axes, data, held, (a, b))
            percent = data.summary["exploration_percent"][agent.index]
            colour = colour_of(agent.index)
            axes.set_title(f"agent {agent.index}: {percent:.0f} %", loc="left", fontsize=8, color=colour)
            axes.set_xlim(whole.get_xlim())
            axes.set_ylim(whole.get_ylim())
            axes.set_xticks([])
            axes.set_yticks([])
    return path


def _paths(axes: Any, data: Any, chosen: Any, plane: tuple[int, int]) -> None:
    a, b = plane
    for agent in data.agents:
        if agent.truth is not None:
            axes.plot(agent.truth.centres[:, a], agent.truth.centres[:, b], color=TRUTH, lw=4, solid_capstyle="round")
    for k in chosen:
        xyz = data.in_world[k]
        axes.plot(xyz[:, a], xyz[:, b], color=colour_of(k), lw=1.4)
    axes.set_aspect("equal")
    dress(axes, "", "", "")


def _over_time(run: Path, title: str, path: Path) -> Path:
    """The error of each agent and of its maps, and bytes by operation, over logical time."""
    with open(run / "timeline.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = list(rows[0])
    time = np.array([float(row["time_s"]) for row in rows])
    panels = [
        ("ATE of each agent, m", [n for n in names if n.startswith("ate_rmse_m_")]),
        ("ATE of each agent's maps, m", [n for n in names if n.startswith("map_rmse_m_")]),
    ]
    with saved_figure(path, (12.0, 3.4)) as figure:
        for k, (label, chosen) in enumerate(panels):
            axes = figure.add_subplot(1, 3, k + 1)
            for number, name in enumerate(chosen):
                values = np.array([float(row[name]) if row[name] else np.nan for row in rows])
                axes.plot(time, values, color=colour_of(number), lw=1.1)
            axes.set_ylim(bottom=0)
            dress(axes, "", "s", label)
        axes = figure.add_subplot(1, 3, 3)
        stack = [np.array([float(row[f"{name}_wire_bytes"]) for row in rows]) / 1e6 for name in _OPERATIONS]
        axes.stackplot(time, stack, labels=_OPERATIONS, colors=[_COLOURS[n] for n in _OPERATIONS])
        axes.legend(frameon=False, fontsize=8, loc="upper left")
        dress(axes, "", "s", "MB on the wire")
        figure.suptitle(title, x=0.01, ha="left", color=INK)
    return path
