"""One sparse model of all agents that share a frame, from the COLMAP model that each of them holds.

Each agent's own key-frames stand where it has them itself; what its copies of others' maps say is only which points are
the same. So cameras, key-frames and frames in between come from one estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from maslam.backend.geometry import Array, product, se3_inverse
from maslam.backend.refitting import refit_points
from maslam.frontend.files.trajectory import read_tum
from maslam.mas.manifest import CameraEntry
from maslam.mas.output.run_folder import later
from maslam.mas.output.stored_camera import turn_to_stored

from ..common.errors import ToolError
from ..report.run_data import RunData
from .colmap_tables import ModelTables, read_model
from .rectified_pixels import rectified_pixels

_KEYS_A_PIXEL, _MARGIN_PX, _KEY_BITS = 32, 4096, 20  # the same view in two models: written from the same numbers
_JOINED_PX = 2.0  # a point that two agents share is one where all its views agree within this
_VIEW_PX = 4.0  # farther off, a view is not one of its point: COLMAP's own limit

MODEL = Path("maps", "colmap")


@dataclass(frozen=True, eq=False)
class TeamModel:
    """Images: ``agents`` ``(I,)``, ``stamps_ns`` ``(I,)`` of the source, ``poses`` ``(I, 4, 4)`` ``T_F_C`` of the
    rectified cameras; views, ordered by image: ``image`` ``(n,)``, ``uv`` ``(n, 2)`` rectified pixels, ``point``
    ``(n,)``, ``errors`` ``(n,)`` pixels; ``points`` ``(P, 3)`` in F, each of at least two views."""

    agents: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    poses: Array
    image: NDArray[np.int64]
    uv: Array
    point: NDArray[np.int64]
    errors: Array
    points: Array

    def of_agent(self, agent: int) -> TeamModel:
        """Its images alone, and the points that two of them see."""
        kept = self.agents == agent
        number = np.cumsum(kept) - 1
        seen = kept[self.image]
        images = replace(
            self,
            agents=self.agents[kept],
            stamps_ns=self.stamps_ns[kept],
            poses=self.poses[kept],
            image=number[self.image[seen]],
            uv=self.uv[seen],
            point=self.point[seen],
            errors=self.errors[seen],
        )
        return _of_two_views(images)

    def with_frames(self, agent: int, stamps_ns: NDArray[np.int64], poses: Array) -> TeamModel:
        """With more images of an agent, which see no points; images stay in order of agent and time."""
        agents = np.concatenate([self.agents, np.full(len(stamps_ns), agent)])
        stamps = np.concatenate([self.stamps_ns, stamps_ns])
        order = np.lexsort([stamps, agents])
        number = np.argsort(order)[self.image]
        by_image = np.argsort(number, kind="stable")
        return replace(
            self,
            agents=agents[order],
            stamps_ns=stamps[order],
            poses=np.concatenate([self.poses, poses])[order],
            image=number[by_image],
            uv=self.uv[by_image],
            point=self.point[by_image],
            errors=self.errors[by_image],
        )


@dataclass(frozen=True, eq=False)
class _OwnViews:
    """All views of the agents' own key-frames; ``label`` ``(n,)``: the point, -1 without one; ``points``: its place by
    label."""

    image: NDArray[np.int64]
    uv: Array
    label: NDArray[np.int64]
    points: Array


def team_model(run: RunData, members: Sequence[int]) -> TeamModel:
    """The model of agents that share a frame. Agents without a placed key-frame have no images in it.

    ``ToolError`` where a model of theirs is missing or is not of this version.
    """
    tables = {a: read_model(run.folder / run.agents[a].name / MODEL) for a in members if _has_model(run, a)}
    cameras = {a: run.manifest.agents[a].camera for a in tables}
    own = {a: np.flatnonzero(one.cameras == a + 1) for a, one in tables.items()}
    stamps = [_stamps(run, a, len(own[a])) for a in tables]
    poses = [_rectified_poses(tables[a].T_C_W[own[a]], cameras[a]) for a in tables]
    agents = np.repeat(np.array(list(tables), dtype=np.int64), [len(own[a]) for a in tables])
    all_poses = np.concatenate([np.zeros((0, 4, 4)), *poses])
    intrinsics = np.array([(c.fx, c.fy, c.cx, c.cy) for c in (cameras[a] for a in agents.tolist())]).reshape(-1, 4)
    views = _joined(tables, own)
    rectified = np.concatenate(
        [np.zeros((0, 2)), *(rectified_pixels(tables[a].uv[_rows(tables[a], own[a])], cameras[a]) for a in tables)]
    )
    usable = (views.label >= 0) & np.isfinite(rectified).all(axis=1)
    once = _once(views.image[usable], views.label[usable])
    views = _OwnViews(views.image[usable][once], rectified[usable][once], views.label[usable][once], views.points)
    views, errors = _fitted(views, agents, se3_inverse(all_poses), intrinsics)
    near = errors <= _VIEW_PX
    model = TeamModel(
        agents=agents,
        stamps_ns=np.concatenate([np.zeros(0, dtype=np.int64), *stamps]),
        poses=all_poses,
        image=views.image[near],
        uv=views.uv[near],
        point=views.label[near],
        errors=errors[near],
        points=views.points,
    )
    return _of_two_views(model)


def _has_model(run: RunData, agent: int) -> bool:
    folder = run.folder / run.agents[agent].name
    if (folder / MODEL / "images.bin").is_file():
        return True
    if (folder / "map.ply").is_file():
        raise ToolError(f"{folder / MODEL}: there is no COLMAP model; the run is of an earlier version: run it again")
    return False


def _stamps(run: RunData, agent: int, images: int) -> NDArray[np.int64]:
    """Times of the agent's own images in the source: those of its placed key-frames, in the same order."""
    one = run.agents[agent]
    path = run.folder / one.name / "trajectory_keyframes.tum"
    stamps = later(read_tum(path), one.file_ns).stamps_ns
    if len(stamps) != images:
        raise ToolError(f"{path}: {len(stamps)} key-frames, but {images} images in {MODEL.as_posix()}")
    return stamps


def _rectified_poses(T_S_F: Array, camera: CameraEntry) -> Array:
    """``T_F_C`` of the rectified camera from ``T_S_F`` of that of the image files."""
    return product(se3_inverse(T_S_F), turn_to_stored(camera)) if len(T_S_F) else T_S_F


def _rows(model: ModelTables, images: NDArray[np.intp]) -> NDArray[np.intp]:
    """Views of these images, in order."""
    return np.flatnonzero(np.isin(model.image, images))


def _joined(tables: dict[int, ModelTables], own: dict[int, NDArray[np.intp]]) -> _OwnViews:
    """Views of all agents' own images, in stored pixels; points that any agent's model has as one get one label."""
    first_point = dict(zip(tables, np.cumsum([0, *(len(t.points) for t in tables.values())]).tolist(), strict=False))
    names = {(a, tables[a].names[row]): k for k, (a, row) in enumerate((a, r) for a in tables for r in own[a].tolist())}
    keys, images, uv, nodes = [], [np.zeros(0, dtype=np.int64)], [np.zeros((0, 2))], []
    for mine in (True, False):  # own views first
        for holder, one in tables.items():
            owners = {c - 1 for c in np.unique(one.cameras).tolist()} & tables.keys()
            wanted = {holder} if mine else owners - {holder}
            number = np.array(
                [names.get((int(c) - 1, n), -1) if int(c) - 1 in wanted else -1
                 for c, n in zip(one.cameras, one.names, strict=True)], dtype=np.int64,
            )  # fmt: skip
            rows = np.flatnonzero((number[one.image] >= 0) & (mine | (one.point >= 0)))
            image, seen = number[one.image[rows]], one.point[rows]
            keys.append(_keys(image, one.uv[rows]))
            nodes.append(np.where(seen >= 0, seen + first_point[holder], -1))
            if mine:
                images.append(image)
                uv.append(one.uv[rows])
    count = sum(len(i) for i in images)
    key, node = np.concatenate([np.zeros(0, int), *keys]), np.concatenate([np.zeros(0, int), *nodes])
    points = np.concatenate([np.zeros((0, 3)), *(t.points for t in tables.values())])
    label, merged = _labels(key, node, points)
    return _OwnViews(np.concatenate(images), np.concatenate(uv), label[:count], merged)


def _keys(image: NDArray[np.int64], uv: Array) -> NDArray[np.int64]:
    """One number ``(n,)`` for each view, the same in every model that has it."""
    place = np.rint((uv + _MARGIN_PX) * _KEYS_A_PIXEL).astype(np.int64).clip(0, 2**_KEY_BITS - 1)
    return (((image << _KEY_BITS) | place[:, 0]) << _KEY_BITS) | place[:, 1]


def _labels(key: NDArray[np.int64], node: NDArray[np.int64], points: Array) -> tuple[NDArray[np.int64], Array]:
    """Label ``(n,)`` of each view: views with the same ``key`` are one view, so the points ``node`` that it has in
    several models are one; and the mean place of each label."""
    if not len(node):
        return node, points
    _, view = np.unique(key, return_inverse=True)
    views, rows = int(view.max()) + 1, np.flatnonzero(node >= 0)
    ends = np.ones(len(rows)), (view[rows], views + node[rows])
    size = views + len(points)
    _, component = connected_components(coo_array(ends, shape=(size, size)), directed=False)
    used, of_point = np.unique(component[views:], return_inverse=True)
    count = np.bincount(of_point, minlength=len(used))
    merged = np.column_stack([np.bincount(of_point, points[:, k], minlength=len(used)) for k in range(3)])
    of_view = component[view]
    at = np.minimum(np.searchsorted(used, of_view), max(len(used) - 1, 0))
    known = used[at] == of_view if len(used) else np.zeros(len(of_view), dtype=bool)
    return np.where(known, at, -1), merged / np.maximum(count, 1)[:, None]


def _once(image: NDArray[np.int64], label: NDArray[np.int64]) -> NDArray[np.intp]:
    """Rows to keep so that an image sees a point once."""
    _, first = np.unique(np.column_stack([image, label]), axis=0, return_index=True)
    return np.sort(first)


def _fitted(views: _OwnViews, agents: NDArray[np.int64], T_C_F: Array, intrinsics: Array) -> tuple[_OwnViews, Array]:
    """Points where their views see them, and each view's error. A point of several agents whose views do not agree
    becomes one point an agent: their poses differ there by more than a map can be sharp."""
    points, errors = _refitted(views, T_C_F, intrinsics)
    owner = agents[views.image]
    least, most = np.full(len(points), len(agents)), np.full(len(points), -1)
    np.minimum.at(least, views.label, owner)
    np.maximum.at(most, views.label, owner)
    worst = np.zeros(len(points))
    np.maximum.at(worst, views.label, errors)
    apart = ((least < most) & (worst > _JOINED_PX))[views.label]
    if not apart.any():
        return replace(views, points=points), errors
    parts, number = np.unique(np.column_stack([views.label, np.where(apart, owner, -1)]), axis=0, return_inverse=True)
    split = replace(views, label=number.ravel().astype(np.int64), points=views.points[parts[:, 0]])
    points, errors = _refitted(split, T_C_F, intrinsics)
    return replace(split, points=points), errors


def _refitted(views: _OwnViews, T_C_F: Array, intrinsics: Array) -> tuple[Array, Array]:
    order = np.argsort(views.label, kind="stable")
    start = np.searchsorted(views.label[order], np.arange(len(views.points) + 1))
    points = refit_points(views.points, start, views.image[order], views.uv[order], T_C_F, intrinsics)
    T, c = T_C_F[views.image], intrinsics[views.image]
    points_C = np.einsum("nij,nj->ni", T[:, :3, :3], points[views.label]) + T[:, :3, 3]
    errors, ahead = np.full(len(views.uv), np.inf), points_C[:, 2] > 0
    uv = points_C[ahead, :2] / points_C[ahead, 2:] * c[ahead, :2] + c[ahead, 2:]
    errors[ahead] = np.linalg.norm(uv - views.uv[ahead], axis=1)
    return points, errors


def _of_two_views(model: TeamModel) -> TeamModel:
    """Without points of less than two views, which COLMAP's adjustment refuses."""
    kept = np.bincount(model.point, minlength=len(model.points)) >= 2
    number, seen = np.cumsum(kept) - 1, kept[model.point]
    return replace(
        model,
        image=model.image[seen],
        uv=model.uv[seen],
        point=number[model.point[seen]],
        errors=model.errors[seen],
        points=model.points[kept],
    )
