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


class Thumbnail(maslam.Descriptor):
    """The image at 24 x 16 pixels, its mean taken off, scaled to unit length: enough for two drives at one hour.

    Its thresholds are guesses; ``maslam netvlad calibrate`` measures those of an ONNX file.
    """

    name = "thumbnail"
    dim = 24 * 16
    threshold = 0.5
    candidate_threshold = 0.8

    def describe(self, images: Iterable[NDArray[np.uint8]]) -> NDArray[np.float32]:
        rows = [self._one(image) for image in images]
        return np.array(rows, dtype=np.float32).reshape(-1, self.dim)

    def _one(self, image: NDArray[np.uint8]) -> NDArray[np.float64]:
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        small = np.asarray(cv2.resize(grey, (24, 16), interpolation=cv2.INTER_AREA), dtype=np.float64).ravel()
        small -= small.mean()
        length = float(np.linalg.norm(small))
        return small / length if length > 0 else np.full(self.dim, self.dim**-0.5)


def main(images: str, out: str) -> None:
    run = maslam.slam(images, out, descriptor=Thumbnail())
    print(f"descriptor {run.manifest.descriptor.name}: {run.summary.matches.accepted} matches accepted")


if __name__ == "__main__":
    main(*sys.argv[1:])
