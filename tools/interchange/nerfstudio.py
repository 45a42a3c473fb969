"""``transforms.json`` and its points, in nerfstudio's axes.

A camera of nerfstudio looks along its -Z, +Y up. Its world is turned as its own conversion of COLMAP models turns it,
``applied_transform``: (x, y, z) becomes (x, z, -y), so that a level camera stands upright, +Z up.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from maslam.backend.geometry import product, se3_inverse
from maslam.mas.manifest import CameraEntry

from .colmap_tables import HALF_PX, ModelParts
from .point_cloud import write_points

TRANSFORMS, CLOUD = "transforms.json", "sparse_pc.ply"
APPLIED = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0]])
"""``(3, 4)``: from the model's coordinates to those of the file."""
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # a camera of OpenGL in that of OpenCV


def write_transforms(folder: Path, parts: ModelParts, images: str) -> None:
    """Write both files into ``folder``, whose folder ``images`` holds the images."""
    T_N_W = np.vstack([APPLIED, [0.0, 0.0, 0.0, 1.0]])
    T_N_G = product(product(T_N_W, se3_inverse(parts.T_C_W)), _OPENGL)
    shared = _intrinsics(parts.cameras[0]) if len(parts.cameras) == 1 else {}
    frames = []
    for row in sorted(range(len(parts.names)), key=lambda k: parts.names[k]):
        own = {} if shared else _intrinsics(parts.cameras[int(parts.cameras_of[row])])
        path = f"{images}/{parts.names[row]}"
        frames.append({"file_path": path, **own, "transform_matrix": T_N_G[row].tolist(), "colmap_im_id": row + 1})
    content = {
        "camera_model": "PINHOLE",
        **shared,
        "applied_transform": APPLIED.tolist(),
        "ply_file_path": CLOUD,
        "frames": frames,
    }
    (folder / TRANSFORMS).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    write_points(folder / CLOUD, parts.points @ APPLIED[:, :3].T + APPLIED[:, 3], parts.colours)


def _intrinsics(c: CameraEntry) -> dict[str, Any]:
    """Pixels; the first one's centre is at (0.5, 0.5), as in COLMAP."""
    return {"w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx + HALF_PX, "cy": c.cy + HALF_PX}
