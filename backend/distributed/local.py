"""A robot's share as arrays: rows for its own nodes, then for its neighbours' separators, and the stages' equations
on them.
"""

from __future__ import annotations

import numpy as np

from ..central.linear import edge_costs, isotropic_weights, pose_blocks, rotation_blocks
from ..central.relaxation import Relaxation
from ..geometry import Array, project_to_so3, se3, so3_exp, so3_log
from ..pose_graph.graph import NodeId
from .share import Share


class LocalProblem:
    """Poses ``(n, 4, 4)`` of own nodes (the first ``own_count`` rows) and separators of neighbours (NaN until received
    of).
    """

    def __init__(self, share: Share) -> None:
        self.share = share
        own = sorted(share.poses)
        ghosts = sorted({n for e in share.edges for n in (e.i, e.j)} - set(own))
        self.nodes: list[NodeId] = own + ghosts
        self.own_count = len(own)
        row = {n: k for k, n in enumerate(self.nodes)}
        edges = share.edges
        self.ends = np.array([(row[e.i], row[e.j]) for e in edges], dtype=np.intp).reshape(-1, 2)
        self.measured = np.array([e.T_i_j for e in edges]).reshape(-1, 4, 4)
        self.kappa, self.tau = isotropic_weights(np.array([e.information for e in edges]), share.dimension)
        weights = np.array([e.weight for e in edges])
        self.kappa, self.tau = self.kappa * weights, self.tau * weights
        # An edge between two robots stands in both shares and is counted by the lower one.
        self.counted = np.array([min(e.i.robot, e.j.robot) == share.robot for e in edges], dtype=bool)
        self.poses = np.full((len(self.nodes), 4, 4), np.nan)
        self.poses[: self.own_count] = [share.poses[n] for n in own]
        self.log_units = np.concatenate([share.log_units(own), np.full(len(ghosts), 0.0)])
        self.sent_rows: dict[int, list[int]] = {}
        self.received_rows: dict[int, list[int]] = {}
        for neighbour in share.neighbours:
            mine, theirs = share.separators_with(neighbour)
            self.sent_rows[neighbour] = [row[n] for n in mine]
            self.received_rows[neighbour] = [row[n] for n in theirs]
        # The anchor robot's first node stays where it is.
        self.given = [0] if share.robot == share.members[0] else []

    def rescale(self, scales: dict[int, float]) -> None:
        """Bring poses and measurements into the common unit: ``scales`` of this robot and its neighbours."""
        s_node = np.array([scales[n.robot] for n in self.nodes])
        s_edge = np.array([scales[e.i.robot] for e in self.share.edges])
        self.poses[:, :3, 3] *= s_node[:, None]
        self.measured[:, :3, 3] *= s_edge[:, None]
        self.tau = self.tau / s_edge**2

    def cost(self) -> float:
        """F over the edges this robot counts; edges to nodes without a pose are left out."""
        i, j = self.ends[self.counted].T
        costs = edge_costs(
            self.poses[i], self.poses[j], self.measured[self.counted], self.kappa[self.counted], self.tau[self.counted]
        )
        return float(costs[np.isfinite(costs)].sum())

    def rotation_stage(self, warm: bool) -> Relaxation:
        """The relaxed rotation problem; nothing known but the anchor, or, ``warm``, starting from the current
        rotations.
        """
        values = np.full((len(self.nodes), 3, 3), np.nan)
        start = slice(None) if warm else self.given
        values[start] = np.swapaxes(self.poses[start, :3, :3], 1, 2)
        blocks = rotation_blocks(self.measured[:, :3, :3], self.kappa)
        return Relaxation(self.ends, blocks, values, self.own_count, self.given)

    def take_rotations(self, stage: Relaxation) -> None:
        """Project the relaxed rotations; nodes the stage did not reach keep their pose."""
        reached = stage.known()
        reached[self.given] = False
        self.poses[reached, :3, :3] = project_to_so3(np.swapaxes(stage.values[reached], 1, 2))

    def pose_stage(self, reached: np.ndarray, warm: bool) -> Relaxation:
        """One Gauss-Newton step around the current rotations; ``warm``: starting from the current translations."""
        values = np.full((len(self.nodes), 6, 1), np.nan)
        start = reached.copy() if warm else np.zeros(len(self.nodes), dtype=bool)
        start[self.given] = True
        values[start] = 0.0
        values[start, :3, 0] = self.poses[start, :3, 3]
        i, j = self.ends.T
        usable = reached[i] & reached[j]
        hessian, rhs = np.zeros((len(i), 12, 12)), np.zeros((len(i), 12, 1))
        R = self.poses[:, :3, :3]
        hessian[usable], rhs[usable] = pose_blocks(
            R[i[usable]], R[j[usable]], self.measured[usable], self.kappa[usable], self.tau[usable]
        )
        return Relaxation(self.ends, (hessian, rhs), values, self.own_count, self.given)

    def take_poses(self, stage: Relaxation) -> None:
        """Apply the step; nodes the stage did not reach keep their pose."""
        reached = stage.known()
        reached[self.given] = False
        x = stage.values[reached, :, 0]
        self.poses[reached] = se3(self.poses[reached, :3, :3] @ so3_exp(x[:, 3:]), x[:, :3])

    def separator_poses(self, neighbour: int) -> Array:
        """Translation and rotation vector ``(k, 6)`` of the own separators this neighbour shares."""
        T = self.poses[self.sent_rows[neighbour]]
        return np.concatenate([T[:, :3, 3], so3_log(T[:, :3, :3])], axis=1)

    def receive_poses(self, neighbour: int, values: Array) -> None:
        """Inverse of :meth:`separator_poses` at the receiver."""
        self.poses[self.received_rows[neighbour]] = se3(so3_exp(values[:, 3:]), values[:, :3])


def scale_stage(share: Share) -> Relaxation:
    """Log scales of this robot (row 0) and its neighbours, from the separators' ``scale``: one unknown per robot.

    Each pair of robots counts once, by the median of its edges, so that one wrong scale among several does no harm;
    metric members (or, where there are none, the anchor) stand fixed at 0.
    """
    robots = [share.robot, *share.neighbours]
    fixed = set(share.members) - share.arbitrary_scale or {share.members[0]}
    values = np.full((len(robots), 1, 1), np.nan)
    values[[k for k, r in enumerate(robots) if r in fixed]] = 0.0
    hessian, rhs = np.zeros((len(robots) - 1, 2, 2)), np.zeros((len(robots) - 1, 2, 1))
    for k, neighbour in enumerate(share.neighbours):
        # log of the neighbour's unit in this robot's: T_i_j holds the size of j's unit in i's.
        logs = [
            np.log(e.scale) * (1.0 if e.i.robot == share.robot else -1.0)
            for e in share.edges
            if {e.i.robot, e.j.robot} == {share.robot, neighbour}
        ]
        difference, weight = float(np.median(logs)), float(len(logs))
        hessian[k] = weight * np.array([[1.0, -1.0], [-1.0, 1.0]])
        rhs[k, :, 0] = weight * np.array([-difference, difference])
    ends = np.array([(0, k + 1) for k in range(len(robots) - 1)], dtype=np.intp).reshape(-1, 2)
    return Relaxation(ends, (hessian, rhs), values, 1, [0] if share.robot in fixed else [])
