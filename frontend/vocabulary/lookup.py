"""Interface of a vocabulary for the odometry; :class:`maslam.frontend.vocabulary.vocabulary.Vocabulary` has it."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .vocabulary import BagOfWords


class WordLookup(Protocol):
    """Words of ORB descriptors ``(n, 32)``."""

    def words(self, descriptors: NDArray[np.uint8]) -> NDArray[np.int32]:
        """DBoW2 node ids ``(n, 2)`` at levels 3 and 4, for the five files."""
        ...

    def bag(self, descriptors: NDArray[np.uint8]) -> BagOfWords:
        """The tf-idf vector of an image with these descriptors, to find it again."""
        ...
