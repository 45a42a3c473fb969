"""Read images in a layout of your own: here ``frames.csv`` (time in seconds, file) and ``camera.json``.

python examples/04_own_dataset.py FOLDER OUT
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np

import maslam


class CsvReader(maslam.Reader):
    """One camera, images without distortion; an own camera would be rectified here."""

    kind = "csv"

    def recognises(self, folder: Path) -> bool:
        return (folder / "frames.csv").is_file() and (folder / "camera.json").is_file()

    def open(self, folder: Path, rig: maslam.RigKind | None) -> maslam.ImageSequence:
        if rig not in (None, maslam.RigKind.MONO):
            raise maslam.MaslamError(f"{folder}: one camera, cannot be read as {rig}")
        camera = maslam.PinholeCamera(**json.loads((folder / "camera.json").read_text(encoding="utf-8")))
        with open(folder / "frames.csv", encoding="utf-8", newline="") as file:
            rows = [(float(row["time_s"]), folder / row["file"]) for row in csv.DictReader(file)]
        return maslam.ImageSequence(
            kind=self.kind,
            name=folder.name,
            rig=maslam.Rig(maslam.RigKind.MONO, camera),
            stamps_ns=np.array([round(time_s * 1e9) for time_s, _ in rows], dtype=np.int64),
            left=tuple(path for _, path in rows),
            stored_size=(camera.width, camera.height),
        )


def main(folder: str, out: str) -> None:
    dataset = maslam.open_dataset(folder, readers=[CsvReader()])
    print(f"{dataset.kind}: {len(dataset.sequences[0])} frames, camera {dataset.sequences[0].rig.camera}")
    sequences = maslam.preprocess(folder, out, readers=[CsvReader()])
    print(f"{sequences.manifest.kind}: {[agent.keyframes for agent in sequences.agents]} key-frames")


if __name__ == "__main__":
    main(*sys.argv[1:])
