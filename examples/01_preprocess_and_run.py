"""Preprocess a folder of images and run the agents on it.

python examples/01_preprocess_and_run.py IMAGES OUT
"""

from __future__ import annotations

import sys

import maslam


def told(title: str, done: int, total: int) -> None:
    if done == total:
        print(f"  {title}: {total} done")


def main(images: str, out: str) -> None:
    sequences = maslam.preprocess(images, f"{out}/sequences", progress=told)
    for problem in sequences.problems:
        print(f"  note: {problem}")

    run = maslam.run(sequences, f"{out}/run", seed=0, settings={"places.gap_keyframes": 2}, progress=told)
    print(f"{len(run.summary.groups)} group(s), {run.summary.matches.accepted} matches accepted")
    for agent in run.agents:
        error_m = run.summary.ate_rmse_m.agents[agent.index]
        error = "no ground truth" if error_m is None else f"ATE {error_m:.3f} m"
        print(f"{agent.name}: {len(agent.trajectory)} poses, {len(agent.keyframes)} key-frames, {error}")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except maslam.MaslamError as error:
        sys.exit(str(error))
