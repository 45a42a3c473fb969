"""The two-stage solution on arrays: chordal rotations, then Gauss-Newton steps for the poses.

Needs no initial guess; the start of every solver that needs one (Carlone et al., ICRA 2015).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..components import first_of_parts
from ..geometry import Array, project_to_so3, se3, so3_exp
from .large_system import pose_system
from .linear import rotation_blocks
from .relaxation import Relaxation


def two_stage_poses(
    ends: NDArray[np.intp],
    measured: Array,
    weights: tuple[Array, Array],
    poses: Array,
    newton_steps: int = 1,
    held: Sequence[int] | None = None,
) -> Array:
    """Poses ``(n, 4, 4)`` that (nearly) minimise F; the nodes ``held`` (the first of each connected part, if not given)
    stay as in ``poses``.

    ``ends`` ``(m, 2)`` rows of the nodes, ``measured`` ``(m, 4, 4)``, ``weights`` kappa and tau ``(m,)``.
    """
    n = len(poses)
    held = list(first_of_parts(ends, n) if held is None else held)
    values = np.full((n, 3, 3), np.nan)
    values[held] = np.swapaxes(poses[held, :3, :3], 1, 2)
    stage = Relaxation(ends, rotation_blocks(measured[:, :3, :3], weights[0]), values, n, held)
    stage.sweep(1.0)
    poses = poses.copy()
    free = np.setdiff1d(np.arange(n), held)
    poses[free, :3, :3] = project_to_so3(np.swapaxes(stage.values[free], 1, 2))
    del stage  # of large graphs its factor is much of the memory
    for _ in range(newton_steps):
        system = pose_system(ends, poses[:, :3, :3], measured, weights, free)
        step = system.solve(np.concatenate([poses[:, :3, 3:], np.zeros((n, 3, 1))], axis=1))[:, :, 0]
        poses[free] = se3(poses[free, :3, :3] @ so3_exp(step[:, 3:]), step[:, :3])
    return poses
