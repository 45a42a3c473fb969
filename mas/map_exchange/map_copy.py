"""A copy of another agent's map, as its holder sees it.

:class:`MapCopy` is what an agent holds. What a run's results tell about it, errors and counts, is
:class:`maslam.mas.evaluation.summary.MapCopyFigures`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, Sim3, se3_inverse

from ..protocol.ids import FrameId
from ..protocol.map_messages import SubMap
from ..protocol.tensors import POSE_WIDTH, Tensor, pack_poses, pack_sim3s, unpack_poses, unpack_sim3s
from ..state.agent_state import stretched
from ..state.place_match import ReportedMatch
from .versions import MapVersion


@dataclass(frozen=True)
class SoldVersion:
    """One ``version`` of ``owner``'s map as ``seller`` has it for sale: what is ordered, refused or kept."""

    seller: int
    owner: int
    version: int


@dataclass(frozen=True, eq=False)
class MapCopy:
    """``sold``: which version of whose map, and who sold it; ``route``: through whose hands it came, the owner first,
    the seller last.

    ``placement``: ``T_mine_map``; the map's own coordinates are ``frame`` in the owner's unit. ``keyframes``,
    ``stamps_ns`` ``(K,)``; ``map_poses`` ``(K, 4, 4)``; ``map_units`` ``(K,)``: each key-frame's own unit in the map's
    (1 but with one camera); ``references`` ``(P,)``: row of each point's key-frame; ``points_C`` ``(P, 3)`` in that
    camera and its unit; ``descriptors`` ``(P, 32)`` or None; ``matches``: the owner's accepted
    ones. ``map_version``: the versions to sell on, None in the thesis's form.
    """

    sold: SoldVersion
    route: tuple[int, ...]
    frame: FrameId
    placement: Sim3
    keyframes: NDArray[Any]
    stamps_ns: NDArray[Any]
    map_poses: Array
    map_units: Array
    references: NDArray[Any]
    points_C: Array
    descriptors: NDArray[np.uint8] | None
    matches: tuple[ReportedMatch, ...]
    map_version: MapVersion | None = None

    @property
    def owner(self) -> int:
        """The agent whose map it is."""
        return self.sold.owner

    @property
    def version(self) -> int:
        """The owner's number of this version."""
        return self.sold.version

    @property
    def seller(self) -> int:
        """The agent that it was bought from."""
        return self.sold.seller

    @cached_property
    def poses(self) -> Array:
        """``(K, 4, 4)`` ``T_F_C`` in the holder's coordinates."""
        return self.placement.transform_poses(self.map_poses)

    @property
    def unit(self) -> float:
        """The owner's unit in the holder's coordinates."""
        return self.placement.scale

    @cached_property
    def units(self) -> Array:
        """``(K,)``: the key-frames' own units in the holder's coordinates."""
        return self.map_units * self.unit

    @cached_property
    def rows(self) -> dict[int, int]:
        """Row of each of the owner's key-frames."""
        return {int(k): row for row, k in enumerate(self.keyframes)}

    @cached_property
    def matches_with(self) -> dict[int, list[ReportedMatch]]:
        """The owner's matches with each other agent."""
        found: dict[int, list[ReportedMatch]] = {}
        for match in self.matches:
            found.setdefault(match.id.end_of(self.owner)[1], []).append(match)
        return found

    def pose(self, row: int) -> Sim3:
        """``T_F_C`` of a row, with the key-frame's own unit as scale."""
        return Sim3(self.poses[row, :3, :3], self.poses[row, :3, 3], float(self.units[row]))

    def points(self) -> Array:
        """``(P, 3)`` map points in the holder's coordinates."""
        poses = self.poses[self.references]
        points = self.points_C * self.units[self.references, None]
        return np.einsum("pij,pj->pi", poses[:, :3, :3], points) + poses[:, :3, 3]

    def moved(self, motion: Sim3) -> MapCopy:
        """The copy in another place: ``motion`` in the holder's coordinates."""
        return replace(self, placement=motion @ self.placement)


def copy_of_version(map_version: MapVersion, placement: Sim3, route: tuple[int, ...]) -> MapCopy:
    """A map copy of a version that was bought; ``route`` ends with the seller."""
    m = map_version.map
    return MapCopy(
        SoldVersion(route[-1], m.owner, m.version),
        route,
        m.frame,
        placement,
        m.keyframes,
        m.stamps_ns,
        m.poses_F(),
        m.units(),
        m.references,
        m.points_C(),
        m.descriptors,
        m.reported_matches(),
        map_version,
    )


def copy_of_submap(submap: SubMap, frame: FrameId, T_mine_seller: Sim3, seller: int) -> MapCopy:
    """A map copy in the thesis's form; ``frame``: the seller's coordinates."""
    placement = T_mine_seller @ Sim3(np.eye(3), np.zeros(3), submap.unit)
    rows = submap.poses.array()
    units = rows[:, POSE_WIDTH] / submap.unit if rows.shape[1] > POSE_WIDTH else np.ones(len(rows))
    return MapCopy(
        SoldVersion(seller, submap.owner, submap.version),
        (*submap.route, seller),
        frame,
        placement,
        submap.keyframes.array(),
        submap.stamps_ns.array(),
        stretched(unpack_poses(rows[:, :POSE_WIDTH]), 1.0 / submap.unit),
        units,
        submap.references.array(),
        submap.points.array().astype(np.float64),
        submap.descriptors.array(),
        tuple(map(ReportedMatch, submap.matches, unpack_sim3s(submap.transforms))),
    )


def submap_of(copy: MapCopy) -> SubMap:
    """The copy as it is sold on in the thesis's form, in the holder's coordinates."""
    described = copy.descriptors
    drifting = bool((copy.map_units != 1.0).any())
    return SubMap(
        owner=copy.owner,
        version=copy.version,
        unit=copy.unit,
        keyframes=Tensor.of(copy.keyframes, "<i4"),
        stamps_ns=Tensor.of(copy.stamps_ns, "<i8"),
        poses=pack_sim3s([copy.pose(k) for k in range(len(copy.poses))]) if drifting else pack_poses(copy.poses),
        references=Tensor.of(copy.references, "<i4"),
        points=Tensor.of(copy.points_C, "<f4"),
        descriptors=Tensor.of(np.zeros((len(copy.references), 32)) if described is None else described, "|u1"),
        matches=tuple(m.id for m in copy.matches),
        transforms=pack_sim3s([m.T_M_Q for m in copy.matches]),
        route=copy.route,
    )


def with_new_keyframes(old: MapCopy, new: MapCopy) -> MapCopy:
    """The old copy with the key-frames that only the new one has: each follows the key-frame before it, or, before the
    first, precedes the one after it, by the new map's own relative poses (equations 3.5 and 3.6), in its unit there."""
    common = [row for k, row in sorted(new.rows.items()) if k in old.rows]
    if not common:
        return new
    poses, units = [], []
    at = 0
    for row in range(len(new.keyframes)):
        while at + 1 < len(common) and common[at + 1] <= row:
            at += 1
        leader = common[at]
        kept = old.rows[int(new.keyframes[leader])]
        factor = float(old.units[kept] / new.units[leader])
        T_kept_new = old.poses[kept] @ stretched(se3_inverse(new.poses[leader]), factor)
        poses.append(T_kept_new @ stretched(new.poses[row], factor))
        units.append(float(new.map_units[row]) * factor)
    map_poses = new.placement.inverse().transform_poses(np.array(poses))
    return replace(new, map_poses=map_poses, map_units=np.array(units))
