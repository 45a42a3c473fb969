"""A robot's share as arrays: rows for its own nodes, then for its neighbours' separators, and the stages' equations
on them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..central.linear import pose_blocks, rotation_blocks
from ..central.relaxation import Relaxation
from ..central.similarity_edges import edges_of
from ..geometry import Array, project_to_so3, se3, so3_exp
from ..pose_graph.graph import NodeId
from .held import HeldPriors
from .places import RIGID, SCALED, Places, places_of
from .share import Share


class LocalProblem:
    """``places`` of own nodes (the first ``own_count`` rows), of neighbours' separators (NaN until received of), and
    where held priors say that nodes are.

    ``nodes`` names the rows but the last ones, of held priors, whose edges come last, too: those ``outside`` ``(m,)``.
    ``fixed`` ``(n,)``: rows whose unit of length is no variable; ``width``: unknowns of a node.
    """

    def __init__(self, share: Share) -> None:
        self.share = share
        own = sorted(share.poses)
        ghosts = sorted({n for e in share.edges for n in (e.i, e.j)} - set(own))
        self.nodes: list[NodeId] = own + ghosts
        self.own_count = len(own)
        self.width = SCALED if share.scaled else RIGID
        row = {n: k for k, n in enumerate(self.nodes)}
        ends = np.array([(row[e.i], row[e.j]) for e in share.edges], dtype=np.intp).reshape(-1, 2)
        self.edges = edges_of(share.edges, ends, share.dimension)
        # An edge between two robots stands in both shares and is counted by the lower one.
        self.counted = np.array([min(e.i.robot, e.j.robot) == share.robot for e in share.edges], dtype=bool)
        self.places = Places(np.full((len(self.nodes), 4, 4), np.nan), np.zeros(len(self.nodes)))
        self.places.poses[: self.own_count] = [share.poses[n] for n in own]
        self.places.log_units[: self.own_count] = share.log_units(own)
        self.robots = np.array([n.robot for n in self.nodes], dtype=np.intp)
        self.fixed = np.array([n.robot not in share.arbitrary_scale for n in self.nodes], dtype=bool)
        self.outside = np.zeros(len(self.edges.ends), dtype=bool)
        if share.held is not None:
            self._hold(share.held, row)
        self.sent_rows: dict[int, list[int]] = {}
        self.received_rows: dict[int, list[int]] = {}
        for neighbour in share.neighbours:
            mine, theirs = share.separators_with(neighbour)
            self.sent_rows[neighbour] = [row[n] for n in mine]
            self.received_rows[neighbour] = [row[n] for n in theirs]
        # The anchor's first node stays where it is, unless priors say where all are.
        self.given = [0] if share.robot == share.anchor and share.held is None else []

    def _hold(self, held: HeldPriors, row: dict[NodeId, int]) -> None:
        m, rows = len(held), np.array([row[n] for n in held.priors.nodes], dtype=np.intp)
        more = held.edges(rows, len(self.nodes), self.places.at(rows), self.share.scaled)
        self.edges = self.edges.and_also(more)
        self.counted = np.append(self.counted, np.ones(m, dtype=bool))
        self.outside = np.append(self.outside, np.ones(m, dtype=bool))
        self.places = self.places.and_also(held.places)
        self.robots = np.append(self.robots, np.full(m, self.share.robot))
        self.fixed = np.append(self.fixed, np.ones(m, dtype=bool))

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.places.poses)

    def cost(self) -> float:
        """F over the edges this robot counts; edges to nodes without a pose are left out."""
        costs = self.edges.only(self.counted).costs(self.places.poses, self.places.log_units)
        return float(costs[np.isfinite(costs)].sum())

    def scale_stage(self, warm: bool) -> Relaxation:
        """Log units from the edges' scales alone; those of metric robots and the anchor's first one stand fixed.

        Nothing else is known, or, ``warm``, the present ones.
        """
        values = np.full((len(self.nodes), 1, 1), np.nan)
        values[self.fixed] = 0.0
        start = slice(self.own_count) if warm else self.given
        values[start, 0, 0] = self.places.log_units[start]
        weight, wanted = self.edges.precision, self.edges.log_scale
        hessian = weight[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]])
        rhs = (weight * wanted)[:, None, None] * np.array([[-1.0], [1.0]])
        given = np.union1d(np.flatnonzero(self.fixed[: self.own_count]), self.given).astype(np.intp).tolist()
        return Relaxation(self.edges.ends, (hessian, rhs), values, self.own_count, given)

    def take_log_units(self, stage: Relaxation) -> None:
        """Nodes that the stage did not reach keep theirs."""
        reached = stage.known()
        self.places.log_units[reached] = stage.values[reached, 0, 0]

    def rotation_stage(self, warm: bool) -> Relaxation:
        """The relaxed rotation problem; nothing known but the anchor, or, ``warm``, starting from the current
        rotations.
        """
        values = np.full((len(self.nodes), 3, 3), np.nan)
        start = slice(None) if warm else self.given
        values[start] = np.swapaxes(self.places.poses[start, :3, :3], 1, 2)
        blocks = rotation_blocks(self.edges.measured[:, :3, :3], self.edges.kappa)
        return Relaxation(self.edges.ends, blocks, values, self.own_count, self.given)

    def take_rotations(self, stage: Relaxation) -> None:
        """Project the relaxed rotations; nodes the stage did not reach keep their pose."""
        reached = stage.known()
        reached[self.given] = False
        self.places.poses[reached, :3, :3] = project_to_so3(np.swapaxes(stage.values[reached], 1, 2))

    def pose_stage(self, reached: NDArray[np.bool_], warm: bool) -> Relaxation:
        """One Gauss-Newton step around the current rotations (and units); ``warm``: starting from the current
        translations.
        """
        poses, width = self.places.poses, self.width
        values = np.full((len(self.nodes), width, 1), np.nan)
        start = reached.copy() if warm else np.zeros(len(self.nodes), dtype=bool)
        start[self.given] = True
        values[start] = 0.0
        values[start, :3, 0] = poses[start, :3, 3]
        i, j = self.edges.ends.T
        usable = reached[i] & reached[j]
        hessian, rhs = np.zeros((len(i), 2 * width, 2 * width)), np.zeros((len(i), 2 * width, 1))
        hessian[usable], rhs[usable] = self._pose_blocks(usable, warm)
        return Relaxation(self.edges.ends, (hessian, rhs), values, self.own_count, self.given)

    def _pose_blocks(self, usable: NDArray[np.bool_], warm: bool) -> tuple[Array, Array]:
        poses, edges = self.places.poses, self.edges.only(usable)
        if self.width == SCALED:
            if not warm:  # where nodes are is not known yet: what was measured stands in for it
                poses = poses.copy()
                poses[:, :3, 3] = np.nan
            return edges.blocks(poses, self.places.log_units, self.fixed)
        i, j = edges.ends.T
        R = poses[:, :3, :3]
        return pose_blocks(R[i], R[j], edges.measured, edges.kappa, edges.tau)

    def take_poses(self, stage: Relaxation) -> None:
        """Apply the step; nodes the stage did not reach keep their pose."""
        reached = stage.known()
        reached[self.given] = False
        x, poses = stage.values[reached, :, 0], self.places.poses
        poses[reached] = se3(poses[reached, :3, :3] @ so3_exp(x[:, 3:6]), x[:, :3])
        if self.width == SCALED:
            self.places.log_units[reached] += x[:, 6]

    def separator_places(self, neighbour: int) -> Array:
        """Numbers ``(k, width)`` of the own separators this neighbour shares."""
        return self.places.at(self.sent_rows[neighbour]).numbers(self.width)

    def receive_places(self, neighbour: int, values: Array) -> None:
        """Inverse of :meth:`separator_places` at the receiver."""
        self.places.put(self.received_rows[neighbour], places_of(values))
