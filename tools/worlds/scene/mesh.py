"""Building triangle meshes out of textured faces, and the flat arrays that ray casting and shading read."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Mesh:
    """Unindexed triangles of a world, metres, world axes (+Y down). ``n`` triangles:

    ``vertices`` ``(n, 3, 3)``; ``uv`` ``(n, 3, 2)`` metres along the surface; ``normals`` ``(n, 3, 3)`` unit, outward;
    ``material`` ``(n,)`` row of the material table; ``tint`` ``(n, 3)`` factors on the albedo; ``group`` ``(n,)``
    equal for triangles of one smooth surface (no edge between them needs anti-aliasing); ``zone`` ``(n,)`` the room
    that lights the triangle, -1 under the sky.
    """

    vertices: Floats
    uv: Floats
    normals: Floats
    material: NDArray[np.int32]
    tint: Floats
    group: NDArray[np.int32]
    zone: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.material)

    def moved(self, T_W_M: Floats) -> Mesh:
        """The same surface under a rigid motion ``(4, 4)``; uv stay with the surface."""
        R, t = T_W_M[:3, :3], T_W_M[:3, 3]
        return Mesh(
            self.vertices @ R.T + t, self.uv, self.normals @ R.T, self.material, self.tint, self.group, self.zone
        )

    @staticmethod
    def joined(meshes: list[Mesh]) -> Mesh:
        """One mesh of many; groups are renumbered so that they stay apart."""
        offsets = np.cumsum([0] + [int(m.group.max(initial=-1)) + 1 for m in meshes[:-1]])
        groups = [m.group + np.int32(o) for m, o in zip(meshes, offsets, strict=True)]
        return Mesh(
            np.concatenate([m.vertices for m in meshes]),
            np.concatenate([m.uv for m in meshes]),
            np.concatenate([m.normals for m in meshes]),
            np.concatenate([m.material for m in meshes]),
            np.concatenate([m.tint for m in meshes]),
            np.concatenate(groups),
            np.concatenate([m.zone for m in meshes]),
        )


@dataclass
class MeshBuilder:
    """Collects faces; ``build`` gives the mesh. ``zone`` is stamped on everything added until it is changed."""

    zone: int = -1
    _parts: list[tuple[NDArray, ...]] = field(default_factory=list)
    _groups: int = 0

    def quads(self, corners: Floats, uv: Floats, material: int, tint: object = WHITE) -> None:
        """``corners`` ``(n, 4, 3)`` around each planar face, counter-clockwise seen from outside; ``uv`` ``(n, 4, 2)``
        metres; ``tint`` ``(3,)`` or ``(n, 3)``. Each face is a group of its own."""
        corners, uv = np.asarray(corners, np.float64).reshape(-1, 4, 3), np.asarray(uv, np.float64).reshape(-1, 4, 2)
        n = len(corners)
        if not n:
            return
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        pick = np.array([[0, 1, 2], [0, 2, 3]])
        tints = np.broadcast_to(np.asarray(tint, np.float64), (n, 3))
        groups = self._groups + np.arange(n)
        self._groups += n
        self._add(
            corners[:, pick].reshape(-1, 3, 3),
            uv[:, pick].reshape(-1, 3, 2),
            np.repeat(normal, 6, axis=0).reshape(-1, 3, 3),
            material,
            np.repeat(tints, 2, axis=0),
            np.repeat(groups, 2),
        )

    def surface(
        self, vertices: Floats, faces: NDArray[np.int64], uv: Floats, material: int, tint: object = WHITE
    ) -> None:
        """A smooth surface: ``vertices`` ``(v, 3)``, ``faces`` ``(n, 3)``, ``uv`` ``(v, 2)``; normals averaged at the
        vertices."""
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        face_normals = np.cross(b - a, c - a)
        normals = np.zeros_like(vertices)
        for i in range(3):
            np.add.at(normals, faces[:, i], face_normals)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        n = len(faces)
        self._add(
            vertices[faces],
            uv[faces],
            normals[faces],
            material,
            np.broadcast_to(np.asarray(tint, np.float64), (n, 3)),
            np.full(n, self._groups),
        )
        self._groups += 1

    def wall(
        self,
        start: Floats,
        end: Floats,
        bottom: float,
        top: float,
        material: int,
        tint: object = WHITE,
        uv_start: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """A vertical face from ``start`` to ``end`` (x, z), seen from the side where ``start`` is on the left.

        ``bottom`` and ``top`` are heights above y = 0, metres (so y = -height); u runs from start to end, v down from
        the top of the texture: v = ``uv_start[1]`` at the foot and grows upwards negatively, so textures are anchored
        at the foot of the wall.
        """
        length = float(np.hypot(*(np.asarray(end) - np.asarray(start))))
        p = [
            (start[0], -bottom, start[1]),
            (end[0], -bottom, end[1]),
            (end[0], -top, end[1]),
            (start[0], -top, start[1]),
        ]
        u0, v0 = uv_start
        uv = [(u0, v0), (u0 + length, v0), (u0 + length, v0 - (top - bottom)), (u0, v0 - (top - bottom))]
        self.quads(np.array([p]), np.array([uv]), material, tint)

    def box(
        self, centre: Floats, axes: Floats, size: Floats, material: int, tint: object = WHITE, open_bottom: bool = True
    ) -> None:
        """A box: ``centre`` ``(3,)``, ``axes`` ``(3, 3)`` columns = its x, y (down), z axes in the world, ``size``
        ``(3,)`` metres."""
        faces = (
            (0, 2, 1, +1),
            (0, 2, 1, -1),
            (2, 0, 1, +1),
            (2, 0, 1, -1),
            (1, 0, 2, -1),
            (1, 0, 2, +1),
        )
        corners, uvs = [], []
        for normal_axis, u_axis, v_axis, sign in faces[:5] if open_bottom else faces:
            n, u, v = (axes[:, k] * size[k] / 2 for k in (normal_axis, u_axis, v_axis))
            n = n * sign
            quad = [centre + n - u + v, centre + n + u + v, centre + n + u - v, centre + n - u - v]
            w, h = size[u_axis], size[v_axis]
            uv = [(0.0, 0.0), (w, 0.0), (w, -h), (0.0, -h)]
            if np.dot(np.cross(quad[1] - quad[0], quad[2] - quad[0]), n) < 0:
                quad, uv = [quad[1], quad[0], quad[3], quad[2]], uv
            corners.append(quad)
            uvs.append(uv)
        self.quads(np.array(corners), np.array(uvs), material, tint)

    def build(self) -> Mesh:
        """All parts as one mesh; ValueError without any."""
        if not self._parts:
            raise ValueError("a mesh without faces")
        columns = [np.concatenate(c) for c in zip(*self._parts, strict=True)]
        return Mesh(*columns)

    def _add(self, vertices: Floats, uv: Floats, normals: Floats, material: int, tint: Floats, group: NDArray) -> None:
        n = len(vertices)
        self._parts.append(
            (
                vertices,
                uv,
                normals,
                np.full(n, material, np.int32),
                tint.astype(np.float64),
                group.astype(np.int32),
                np.full(n, self.zone, np.int32),
            )
        )
