"""Key-frame odometry of one camera, stereo pair or RGB-D camera."""

from __future__ import annotations

from pathlib import Path

from threadpoolctl import ThreadpoolController

from maslam.frontend import odometry
from maslam.frontend.cameras.models import Rig
from maslam.frontend.config import OdometryConfig
from maslam.frontend.frames import Frame
from maslam.frontend.odometry import FrameResult, OdometryResult
from maslam.frontend.vocabulary.lookup import WordLookup
from maslam.frontend.vocabulary.vocabulary import Vocabulary
from maslam.tools.common.parallel import one_blas_thread

from .common import PathLike, Settings, changed, nested


class Odometry(odometry.Odometry):
    """Feed frames in order of time with :meth:`process`, then :meth:`finish`. The same frames give the same result, bit
    by bit, on any number of cores.

    Args:
        rig: the rectified camera or pair; of a dataset ``maslam.open_dataset(path).sequences[0].rig``.
        config: all settings as one value; None takes the defaults.
        vocabulary: of ORB words, or a file of one (``.npz``, or DBoW2's text form); None takes the one shipped.
        settings: some settings by name, ``{"features.tracks": 500}``.

    Raises:
        MaslamError: a stereo rig without a baseline, an unknown setting, a vocabulary that cannot be read.
    """

    def __init__(
        self,
        rig: Rig,
        config: OdometryConfig | None = None,
        vocabulary: WordLookup | PathLike | None = None,
        *,
        settings: Settings | None = None,
    ) -> None:
        if vocabulary is None or isinstance(vocabulary, str | Path):
            vocabulary = Vocabulary.load(None if vocabulary is None else Path(vocabulary))
        super().__init__(rig, changed(config or OdometryConfig(), nested(settings)), vocabulary)
        self._libraries = ThreadpoolController()

    def process(self, frame: Frame) -> FrameResult:
        """Pose ``T_W_C`` ``(4, 4)`` of one frame: camera to the frame of the current track (that of its first camera:
        +X right, +Y down, +Z forward), metres, or the track's own unit with one camera. None where there is none;
        ``reason`` then says why. Never raises for what an image shows.

        Raises:
            MaslamError: an image of another size than the camera's.
        """
        with one_blas_thread(self._libraries):
            return super().process(frame)

    def finish(self) -> OdometryResult:
        """Everything found, with final, bundle-adjusted values: a track, and a trajectory of all its frames, for each
        stretch without loss."""
        with one_blas_thread():
            return super().finish()
