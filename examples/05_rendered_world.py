"""Render a town with exact ground truth, map it with several agents, and see how good the map is.

python examples/05_rendered_world.py OUT [AGENTS FRAMES]
"""

from __future__ import annotations

import sys

import maslam


def main(out: str, agents: str = "3", frames: str = "60") -> None:
    world = maslam.render(f"{out}/images", seed=1, agents=int(agents), frames=int(frames), size=(320, 180), workers=2)

    run = maslam.slam(world.root, f"{out}/run", workers=2)
    figures = maslam.evaluate(run)
    print(f"groups {figures.groups}, {figures.matches.accepted} matches, {figures.matches.false_accepted} false")
    print(f"mean ATE {figures.ate_rmse_m.mean_agents:.3f} m, odometry alone {figures.odometry_mean_rmse_m:.3f} m")
    print(f"report: {run.report}")


if __name__ == "__main__":  # rendering and tracking use several processes, each of which imports this file
    main(*sys.argv[1:])
