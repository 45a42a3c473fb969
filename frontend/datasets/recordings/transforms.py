"""How the frames of a robot stand to each other, by the transforms (``tf``) in a bag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, rotation_from_quat_wxyz, se3, se3_inverse

from .bag import Bag
from .message_file import Topic

Array = NDArray[np.float64]

TF_TYPES = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
_MOST = 500  # messages of a topic that are looked at, evenly over the recording
_MOVED_M, _TURNED = 1e-3, 2e-3  # metres, radians: a link that changes by more is a joint, or the robot itself
_DEEPEST = 100
_T_BODY_OPTICAL = se3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))


@dataclass(frozen=True)
class FixedTransforms:
    """``links``: of each frame its parent and ``T_parent_frame`` ``(4, 4)``, metres; ``moving``: frames whose link
    changes within the recording."""

    links: dict[str, tuple[str, Array]]
    moving: frozenset[str] = frozenset()

    def between(self, target: str, source: str) -> Array | None:
        """``T_target_source`` ``(4, 4)``; None where no chain of links that stand still joins the two."""
        above, below = self._ancestors(target), self._ancestors(source)
        common = next((frame for frame in above if frame in below), None)
        return None if common is None else product(se3_inverse(above[common]), below[common])

    def _ancestors(self, frame: str) -> dict[str, Array]:
        """``T_ancestor_frame`` of the frame itself and all above it, as far as links stand still."""
        found = {frame: np.eye(4)}
        for _ in range(_DEEPEST):
            if frame not in self.links or frame in self.moving or self.links[frame][0] in found:
                break
            parent, T_parent_frame = self.links[frame]
            found[parent] = product(T_parent_frame, found[frame])
            frame = parent
        return found


def read_transforms(bag: Bag, topics: Sequence[Topic]) -> FixedTransforms:
    """All links on ``topics``; the first message of a link counts. Those that are no rigid transforms are passed
    over."""
    links: dict[str, tuple[str, Array]] = {}
    moving: set[str] = set()
    for topic in topics:
        for message in bag.sample(topic, _MOST):
            for one in message.transforms:
                parent, child = (name.strip("/") for name in (one.header.frame_id, one.child_frame_id))
                pose = _pose(one.transform)
                if pose is None or parent == child:
                    continue
                if child not in links:
                    links[child] = parent, pose
                elif links[child][0] != parent or _differ(links[child][1], pose):
                    moving.add(child)
    return FixedTransforms(links, frozenset(moving))


def side_by_side(T_left_right: Array, frames: tuple[str, str]) -> tuple[Array, bool]:
    """The transform in axes of cameras (x right, y down, z ahead), and whether it was turned into these: frames that
    are not called optical have a body's (x ahead, y left, z up), which shows where the right one is on the right."""
    if any("optical" in frame for frame in frames) or np.abs(T_left_right[:3, 3]).argmax() != 1:
        return T_left_right, False
    return product(product(se3_inverse(_T_BODY_OPTICAL), T_left_right), _T_BODY_OPTICAL), True


def _pose(transform: object) -> Array | None:
    turn, place = transform.rotation, transform.translation  # type: ignore[attr-defined]
    quaternion = np.array([turn.w, turn.x, turn.y, turn.z], dtype=np.float64)
    position = np.array([place.x, place.y, place.z], dtype=np.float64)
    length = float(np.linalg.norm(quaternion))
    if not np.isfinite(position).all() or not 0.9 < length < 1.1:
        return None
    return se3(rotation_from_quat_wxyz(quaternion / length), position)


def _differ(one: Array, other: Array) -> bool:
    apart = product(se3_inverse(one), other)
    angle = float(np.arccos(np.clip(0.5 * (np.trace(apart[:3, :3]) - 1.0), -1.0, 1.0)))
    return bool(np.linalg.norm(apart[:3, 3]) > _MOVED_M) or angle > _TURNED
