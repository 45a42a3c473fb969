"""The README's picture: what four cameras see, and the one map that their agents agree on. ``python -m
maslam.tools.report.readme_figure RUN OUT.png``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import open_dataset
from maslam.frontend.datasets.stored_image import read_colour

from ..common.figures import colour_of, dress, saved_figure
from .charts import draw_map, top_view
from .run_data import RunData, read_run

SHOWN = 4
INCHES, DPI = (13.2, 4.7), 90


def draw(run: Path, out: Path) -> None:
    """Images of the first agents in their colours on the left, the map on the right; a PNG of about 1600 pixels
    width.
    """
    data = read_run(run)
    with saved_figure(out, INCHES, DPI) as figure:
        grid = figure.add_gridspec(2, 3, width_ratios=[1, 1, 2.0])
        for k in range(min(SHOWN, len(data.agents))):
            _image(figure.add_subplot(grid[k // 2, k % 2]), data, k)
        _map(figure.add_subplot(grid[:, 2]), data)


def _image(axes: Any, data: RunData, index: int) -> None:
    """The agent's image half-way through its sequence, framed in its colour."""
    entry = data.manifest.agents[index]
    sequences = {s.name: s for s in open_dataset(Path(data.manifest.source), RigKind.MONO).sequences}
    picture = read_colour(sequences[entry.sequence].left[entry.first_frame + entry.frames // 2])
    axes.imshow(picture[:, :, ::-1])
    axes.set_title(data.agents[index].name, color=colour_of(index), fontweight="bold", pad=4)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set(color=colour_of(index), linewidth=3)


def _map(axes: Any, data: RunData) -> None:
    """Truth, trajectories after optimisation, and the accepted matches as links."""
    draw_map(axes, top_view(data, range(len(data.agents))), width=2.2, names=True)
    after, before = data.summary["ate_rmse_m"]["mean_agents"], data.summary["odometry_mean_rmse_m"]
    matches = data.summary["matches"]
    errors = f"mean ATE {after:.3f} m, odometry alone {before:.3f} m"
    title = f"One frame: {errors}; {matches['accepted']} matches, {matches['false_accepted']} false"
    dress(axes, title, "metres", "")


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
