"""Draw the trajectories of a finished run from above, with the place matches between agents.

python examples/06_plot_a_run.py RUN PICTURE
"""

from __future__ import annotations

import sys

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot

import maslam


def main(folder: str, picture: str) -> None:
    run = maslam.Run.load(folder)
    figure, (above, bytes_sent) = pyplot.subplots(1, 2, figsize=(10, 4), layout="constrained")

    positions = run.positions_in_truth
    for agent, where in zip(run.agents, positions, strict=True):
        above.plot(where[:, 0], where[:, 2], label=agent.name)
    for match in run.matches:
        if match.accepted and match.query_agent != match.match_agent:
            ends = [(match.query_agent, match.query), (match.match_agent, match.match)]
            rows = [
                int(run.agents[a].trajectory.nearest(run.agents[a].keyframes.stamps_ns[k : k + 1], 10**8)[0])
                for a, k in ends
            ]
            line = [positions[a][row] for (a, _), row in zip(ends, rows, strict=True)]
            above.plot([p[0] for p in line], [p[2] for p in line], color="black", lw=0.6)
    above.set(aspect="equal", xlabel="x, m", ylabel="z, m", title=f"{run.summary.matches.accepted} matches")
    above.legend()

    for operation in ("dvpr", "relpose", "dopt", "mapmerge"):
        bytes_sent.plot(run.timeline["time_s"], run.timeline[f"{operation}_wire_bytes"] / 1e3, label=operation)
    bytes_sent.set(xlabel="logical time, s", ylabel="sent so far, kB")
    bytes_sent.legend()
    figure.savefig(picture, dpi=120)
    print(picture)


if __name__ == "__main__":
    main(*sys.argv[1:])
