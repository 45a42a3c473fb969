"""Figures of a sweep in the manner of the thesis's: 4.7 and 4.8 (bytes and exploration against agents), 4.2 (error over
time), 3.2, 3.3, 4.3 to 4.6, 4.10 and 4.11 (all trajectories, and each agent's maps), time against agents, regret."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..common.figures import FAINT, colour_of, dress, plain_powers, saved_figure
from ..common.text_table import counted
from ..report.charts import OPERATIONS, draw_bytes, draw_lines, draw_map, top_view
from ..report.run_data import RunData, read_run
from .rows import Group

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
        data, stem = read_run(run), f"{sequence}_{agents:03d}_{preset}"
        made.append(_trajectories(data, f"{sequence}, {counted(agents, 'agent')}, {preset}", out / f"map_{stem}.png"))
        made.append(_over_time(data, f"{sequence}, {counted(agents, 'agent')}, {preset}", out / f"time_{stem}.png"))
    return made


def _against_agents(groups: Sequence[Group], sequence: str, path: Path) -> Path:
    """Bytes, exploration, error and time against the number of agents, one colour per preset. Bytes and times of
    presets differ by powers of ten."""
    presets = list(dict.fromkeys(group.preset for group in groups))
    panels = [
        ("MB sent", "wire_total", True),
        ("exploration, %", "exploration", False),
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
        figure.axes[0].legend()
        figure.suptitle(f"KITTI {sequence}" if sequence.isdigit() else sequence, x=0.01, ha="left")
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
        axes.legend()
        dress(axes, "", "bytes over the reference's", "mean ATE over the reference's")
    return path


def _trajectories(data: RunData, title: str, path: Path) -> Path:
    """All trajectories over the truth, then each agent's own map with the copies it holds."""
    view = replace(top_view(data, range(len(data.agents))), links=np.zeros((0, 2, 2)))
    shown = data.agents[:_SHOWN_AGENTS]
    columns = 2 + -(-len(shown) // 2)
    with saved_figure(path, (2.2 * columns, 4.6)) as figure:
        grid = figure.add_gridspec(2, columns)
        whole = figure.add_subplot(grid[:, :2])
        draw_map(whole, view, width=1.4)
        whole.set(title=title, adjustable="box")
        copies = {(c["holder"], c["owner"]) for c in data.summary["map_copies"]}
        for agent in shown:
            axes = figure.add_subplot(grid[agent.index % 2, 2 + agent.index // 2])
            held = [one for one in view.paths if one.index == agent.index or (agent.index, one.index) in copies]
            draw_map(axes, replace(view, paths=held), width=1.4)
            axes.set(adjustable="box", xlim=whole.get_xlim(), ylim=whole.get_ylim())
            percent = data.summary["exploration_percent"][agent.index]
            axes.set_title(f"agent {agent.index}: {percent:.0f} %", fontsize=8, color=colour_of(agent.index))
            axes.tick_params(labelbottom=False, labelleft=False)
    return path


def _over_time(data: RunData, title: str, path: Path) -> Path:
    """The error of each agent and of its maps, and bytes by operation, over logical time."""
    time = data.timeline["time_s"]
    with saved_figure(path, (12.0, 3.4)) as figure:
        agents, maps, on_wire = figure.subplots(1, 3)
        for axes, label, prefix in (
            (agents, "ATE of each agent, m", "ate_rmse_m"),
            (maps, "ATE of each agent's maps, m", "map_rmse_m"),
        ):
            draw_lines(axes, time, {agent.name: data.timeline[f"{prefix}_{agent.name}"] for agent in data.agents})
            dress(axes, "", "s", label)
        draw_bytes(on_wire, time, {name: data.timeline[f"{name}_wire_bytes"] for name in OPERATIONS})
        on_wire.legend(loc="upper left")
        dress(on_wire, "", "s", "bytes sent")
        figure.suptitle(title, x=0.01, ha="left")
    return path
