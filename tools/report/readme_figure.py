"""The README's picture: what four cameras see, and the one map that their agents agree on. ``python -m
maslam.tools.report.readme_figure RUN OUT.png``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import open_dataset

from ..common.errors import ToolError
from ..common.figures import dress
from ..common.plane import plane_of
from ..common.svg import INK, colour_of
from .charts import TRUTH
from .run_data import RunData, read_run

SHOWN = 4
INCHES, DPI = (13.2, 4.7), 90


def draw(run: Path, out: Path) -> None:
    """Images of the first agents in their colours on the left, the map on the right; a PNG of about 1600 pixels
    width.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    data = read_run(run)
    figure = plt.figure(figsize=INCHES, facecolor="white")
    grid = figure.add_gridspec(
        2, 4, width_ratios=[1, 1, 0.05, 2.0], wspace=0.04, hspace=0.16, left=0.01, right=0.985, top=0.9, bottom=0.09
    )
    for k in range(min(SHOWN, len(data.agents))):
        _image(figure.add_subplot(grid[k // 2, k % 2]), data, k)
    _map(figure.add_subplot(grid[:, 3]), data)
    figure.savefig(out, dpi=DPI, metadata={"Software": None})
    plt.close(figure)


def _image(axes: Any, data: RunData, index: int) -> None:
    """What the agent saw half-way, framed in its colour."""
    import cv2

    entry = data.manifest.agents[index]
    sequences = {s.name: s for s in open_dataset(Path(data.manifest.source), RigKind.MONO).sequences}
    path = sequences[entry.sequence].left[entry.first_frame + entry.frames // 2]
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise ToolError(f"{path}: not an image")
    axes.imshow(picture[:, :, ::-1])
    axes.set_title(data.agents[index].name, color=colour_of(index), fontsize=11, fontweight="bold", loc="left", pad=4)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set(color=colour_of(index), linewidth=3)


def _map(axes: Any, data: RunData) -> None:
    """Truth, trajectories after optimisation, and the accepted matches as links."""
    a, b = plane_of(np.concatenate([agent.truth.centres for agent in data.agents if agent.truth is not None]))
    for agent in data.agents:
        if agent.truth is not None:
            axes.plot(
                agent.truth.centres[:, a], agent.truth.centres[:, b], color=TRUTH, linewidth=7, solid_capstyle="round"
            )
    for row in data.accepted:
        ends = [data.position_at(int(row[f"{end}_agent"]), int(row[f"{end}_stamp_ns"])) for end in ("query", "match")]
        if ends[0] is not None and ends[1] is not None:
            axes.plot([ends[0][a], ends[1][a]], [ends[0][b], ends[1][b]], color=INK, linewidth=0.7, alpha=0.5)
    for agent, xyz in zip(data.agents, data.in_world, strict=True):
        axes.plot(xyz[:, a], xyz[:, b], color=colour_of(agent.index), linewidth=2.2)
        axes.plot(xyz[0, a], xyz[0, b], "o", color=colour_of(agent.index), markeredgecolor="white", markersize=9)
    after, before = data.summary["ate_rmse_m"]["mean_agents"], data.summary["odometry_mean_rmse_m"]
    matches = data.summary["matches"]
    errors = f"mean ATE {after:.3f} m, odometry alone {before:.3f} m"
    title = f"One frame: {errors}; {matches['accepted']} matches, {matches['false_accepted']} false"
    axes.set_aspect("equal", adjustable="datalim")
    dress(axes, title, "metres", "")


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
