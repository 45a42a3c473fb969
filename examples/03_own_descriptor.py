"""Recognise places by vectors of your own.

python examples/03_own_descriptor.py IMAGES OUT
"""

from __future__ import annotations

import sys
from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

import maslam


class EdgeMap(maslam.Descriptor):
    """How much the grey level changes in each of 24 x 16 parts of the image: edges stay where they are when the light
    changes.

    The thresholds are guesses from a few pairs; ``maslam netvlad calibrate`` measures those of an ONNX file.
    """

    name = "edge-map"
    dim = 24 * 16
    threshold = 0.85
    candidate_threshold = 0.95

    def describe(self, images: Iterable[NDArray[np.uint8]]) -> NDArray[np.float32]:
        rows = [self._one(image) for image in images]
        return np.array(rows, dtype=np.float32).reshape(-1, self.dim)

    def _one(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        small = cv2.resize(grey.astype(np.float32), (48, 32), interpolation=cv2.INTER_AREA)
        change = np.hypot(cv2.Sobel(small, cv2.CV_32F, 1, 0), cv2.Sobel(small, cv2.CV_32F, 0, 1))
        parts = np.asarray(cv2.resize(np.sqrt(change), (24, 16), interpolation=cv2.INTER_AREA), dtype=np.float32)
        vector = parts.ravel() - parts.mean()
        length = float(np.linalg.norm(vector))
        if length == 0.0:  # an image without texture gets a vector too; nobody uses it
            return np.full(self.dim, self.dim**-0.5, dtype=np.float32)
        return np.asarray(vector / length, dtype=np.float32)


def main(images: str, out: str) -> None:
    run = maslam.slam(images, out, descriptor=EdgeMap())
    print(f"descriptor {run.manifest.descriptor.name}: {run.summary.matches.accepted} matches accepted")


if __name__ == "__main__":
    main(*sys.argv[1:])
