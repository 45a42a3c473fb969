"""The folder of one agent that ``maslam render`` writes: ``camera.yaml``, ``image_0/`` and, by the rig, ``image_1/`` or ``depth_0/``."""

from __future__ import annotations

from pathlib import Path

from frontend import stamps
from frontend.calibration_files import read_calibration
from frontend.cameras import Rig, RigKind
from frontend.datasets import checks
from frontend.datasets.base import ImageSequence, Problems, Reader, choose_rig
from frontend.datasets.images import image_size, list_images
from frontend.errors import FrontendError
from frontend.trajectory import Trajectory, read_kitti_poses


class RenderedReader(Reader):
    """``times.txt`` seconds, one a line; ``poses.txt`` KITTI rows of the left camera; images already ideal."""

    kind = "rendered"

    @classmethod
    def recognises(cls, folder: Path) -> bool:
        return (folder / "camera.yaml").is_file() and (folder / "image_0").is_dir() and (folder / "times.txt").is_file()

    @classmethod
    def open(cls, folder: Path, rig: RigKind | None) -> ImageSequence:
        problems = Problems()
        images = tuple(list_images(folder / "image_0"))
        if not images:
            raise FrontendError(f"{folder / 'image_0'}: no images")
        source = folder / "camera.yaml"
        raw = read_calibration(source)
        size = image_size(images[0])
        checks.check_size(raw.left.size, size, source, images[0], problems)
        camera = raw.left.pinhole(size)
        checks.check_camera(camera, source, problems)
        available = [RigKind.STEREO] if (folder / "image_1").is_dir() and raw.baseline_m is not None else []
        available += [RigKind.RGBD] if (folder / "depth_0").is_dir() and raw.depth_unit_m is not None else []
        chosen = choose_rig([*available, RigKind.MONO], rig, folder)
        right = tuple(folder / "image_1" / path.name for path in images) if chosen is RigKind.STEREO else ()
        depth = tuple((folder / "depth_0" / path.name).with_suffix(".png") for path in images) if chosen is RigKind.RGBD else ()
        checks.check_files(right, "right image", problems)
        checks.check_files(depth, "depth image", problems)
        baseline_m = raw.baseline_m if chosen is RigKind.STEREO else None
        if baseline_m is not None:
            checks.check_baseline(baseline_m, source, problems)
        times = stamps.read_stamps(folder / "times.txt")
        if len(times) != len(images):
            raise FrontendError(f"{folder / 'times.txt'}: {len(times)} times for {len(images)} images")
        checks.check_stamps(times, [path.name for path in images], folder / "times.txt", problems)
        truth = None
        if (folder / "poses.txt").is_file():
            _, poses = read_kitti_poses(folder / "poses.txt")
            if len(poses) != len(images):
                raise FrontendError(f"{folder / 'poses.txt'}: {len(poses)} poses for {len(images)} images")
            truth = Trajectory(times, poses)
        return ImageSequence(
            kind=cls.kind, name=folder.resolve().name, rig=Rig(chosen, camera, baseline_m), stamps_ns=times, left=images,
            stored_size=size, right=right, depth=depth, depth_unit_m=raw.depth_unit_m or 1.0, groundtruth=truth, problems=tuple(problems.found),
        )  # fmt: skip
