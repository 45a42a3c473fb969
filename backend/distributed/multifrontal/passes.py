"""One robot's work in each pass: up, what it says about the poses that stay; down, where its own are."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ...geometry import Array
from ...pose_graph.graph import NodeId
from ..places import moved
from ..share import Share
from .boundary import Boundary
from .elimination import Elimination
from .equations import Equations, Matrices, Unknowns, put_solution, shape_of, solution_at
from .front import Front
from .memory import Memory
from .reports import Step, Sums, Update, put_sent, sent
from .shared_poses import LocalCoordinates

# Share of Gauss-Newton's step that is taken from a mix.
_DAMPED = 0.5


class Passes:
    """``places`` of the front's nodes, in the frame of the anchor's first node, or, ``warm``, in that of all poses."""

    def __init__(self, share: Share, front: Front, below: Mapping[int, Boundary], warm: bool, depth: int) -> None:
        self.front, self._scaled = front, share.scaled
        self.places = front.places(share)
        if not warm:
            self.places.poses[:] = np.eye(4)
            self.places.log_units[:] = 0.0
        self._equations = Equations(front.usable_edges(), front.fixed, share.scaled)
        self._elimination: Elimination | None = None
        self._kind = Matrices.GAUSS_NEWTON
        self._b = np.zeros((0, 0, 0))
        self._brought = front.brought
        self._labels = {robot: b.label for robot, b in below.items()}
        self._grounded = {robot: b.grounded for robot, b in below.items()}
        self._before, self._moves, self._part = self.places, np.zeros((0, 0)), 1.0
        self._memory, self._best = Memory(depth), self.places

    # -- up ----------------------------------------------------------------------------------------------------------

    def carried_of(self, robot: int | None, problem: Unknowns) -> NDArray[np.bool_]:
        """Of the numbers that a robot before, or (None) this one, sends of its boundary, those that are carried."""
        front = self.front
        rows = front.held if robot is None else self._brought[robot]
        if problem is not Unknowns.POSE:
            return np.ones(len(rows) * shape_of(problem, self._scaled)[0], dtype=bool)
        return self._coordinates(rows, robot).carried

    def up(
        self, problem: Unknowns, below: Mapping[int, Update], matrices: Matrices
    ) -> tuple[Array | None, Array, Sums]:
        """What the boundary is left with, in local coordinates where poses move: matrix, right-hand side; and this
        robot's sums."""
        if problem is Unknowns.KNOWN:
            return None, np.zeros((0, 0)), Sums()
        front, equations = self.front, self._equations
        fresh = matrices is not Matrices.OLD
        width, columns = shape_of(problem, self._scaled)
        own = equations.right_hand_sides(problem, self.places, len(front))
        b = own.copy()
        blocks = [(equations.edges.ends, equations.blocks(problem, self.places)[0])] if fresh else []
        for robot, update in sorted(below.items()):
            rows = self._brought[robot]
            hessian, rest = self._whole(problem, robot, update)
            b[rows] += rest.reshape(len(rows), width, columns)
            if fresh:
                assert hessian is not None
                blocks.append((rows[None], hessian[None]))
        if fresh:
            self._elimination, self._kind = self._eliminate(matrices, blocks, width), matrices
        assert self._elimination is not None
        self._b = b
        outer, gain = self._elimination.pushed(b)
        left, flat = self._elimination.left, outer.reshape(-1, columns)
        if problem is Unknowns.POSE and not front.last:
            coordinates = self._coordinates(front.held, None)
            left, local = coordinates.local(left, flat[:, 0])
            flat = local[:, None]
        edges = equations.edges
        cost = equations.cost(self.places) if problem is Unknowns.POSE else 0.0
        freedom = len(edges.ends) - len(front.inner)
        products: tuple[float, ...] = ()
        if problem is Unknowns.POSE:
            if fresh:
                self._memory.restart()
            products = self._memory.note(self.places, own[:, :, 0], b[:, :, 0])
        largest = float(edges.kappa.max(initial=0.0)), float(edges.tau.max(initial=0.0))
        return (left if fresh else None), flat, Sums(cost, gain, *largest, freedom, products=products)

    def _eliminate(self, matrices: Matrices, blocks: list[tuple[NDArray[np.intp], Array]], width: int) -> Elimination:
        front, n = self.front, len(self.front)
        if matrices is Matrices.EXACT and not self._scaled:
            ends, hessian = blocks[0]
            exact = hessian + self._equations.curvature(self.places)
            found = Elimination([(ends, exact), *blocks[1:]], front.inner, front.held, n, width)
            if found.convex:
                return found
        return Elimination(blocks, front.inner, front.held, n, width)

    def _whole(self, problem: Unknowns, robot: int, update: Update) -> tuple[Array | None, Array]:
        if problem is not Unknowns.POSE:
            return update.hessian, update.b
        coordinates = self._coordinates(self._brought[robot], robot)
        hessian = None if update.hessian is None else coordinates.matrix(update.hessian)
        return hessian, coordinates.vector(update.b[:, 0])

    def _coordinates(self, rows: NDArray[np.intp], robot: int | None) -> LocalCoordinates:
        """Of a robot before this one, or (None) of what this one passes on."""
        width, front = shape_of(Unknowns.POSE, self._scaled)[0], self.front
        label = front.label[rows] if robot is None else self._labels[robot]
        grounded = front.grounded if robot is None else self._grounded[robot]
        return LocalCoordinates(self.places.at(rows), label, width, front.fixed[rows], grounded)

    # -- down --------------------------------------------------------------------------------------------------------

    def down(self, problem: Unknowns, step: Step) -> Array:
        """Take in where the boundary is, and find the rest; returns what others are sent of each row ``(n, columns)``:
        whole steps where poses move."""
        front = self.front
        held = front.held
        if not front.last:
            front.lose(held[~step.known])
            self._equations = Equations(front.usable_edges(), front.fixed, self._scaled)
        if problem is Unknowns.POSE:
            return self._move(held, step)
        known = held if front.last else held[step.known]
        if not front.last:
            put_sent(problem, self.places, known, step.numbers)
        if problem is not Unknowns.KNOWN:
            self._find(problem, held)
        return sent(problem, self.places, np.arange(len(front)))

    def _find(self, problem: Unknowns, held: NDArray[np.intp]) -> None:
        assert self._elimination is not None
        front = self.front
        found = self._elimination.solved(self._b, solution_at(problem, self.places, held))
        kept = front.reached[self._elimination.rows]
        rows = self._elimination.rows[kept]
        put_solution(problem, self.places, rows, found[kept])
        # What others are sent is what it is, to the bit.
        shared = rows[front.shared[rows]]
        numbers = sent(problem, self.places, shared).astype(np.float32).astype(np.float64)
        put_sent(problem, self.places, shared, numbers)

    def _move(self, held: NDArray[np.intp], step: Step) -> Array:
        assert self._elimination is not None
        front = self.front
        width = shape_of(Unknowns.POSE, self._scaled)[0]
        sizes = np.repeat([step.grid[0], step.grid[1]], (3, width - 3))
        steps, moves = np.zeros((len(front), width)), np.zeros((len(front), width))
        if not front.last:
            steps[held] = step.numbers
            moves[held] = step.numbers * sizes
        rows = self._elimination.rows
        self._before, self._part = self.places.copy(), 1.0
        if step.weights:
            mix, self._b = self._memory.mixed(step.weights)
            self._b = self._b[:, :, None]
            put_solution(Unknowns.POSE, self.places, np.arange(len(mix)), mix[:, :, None])
        # Gauss-Newton's step is too long where residuals are large; the mixes that follow find what is missing.
        part = _DAMPED if step.weights and self._kind is Matrices.GAUSS_NEWTON else 1.0
        boundary = moves[held][:, :, None] / part
        moves[rows] = part * self._elimination.solved(self._b, boundary)[:, :, 0]
        shared = rows[front.shared[rows]]
        steps[shared] = np.rint(moves[shared] / sizes)
        moves[shared] = steps[shared] * sizes
        put_solution(Unknowns.POSE, self.places, np.arange(len(moves)), moves[:, :, None])
        self._moves = moved(self._before, self.places, width)
        return steps

    def remember(self) -> None:
        """Where poses are is the best so far."""
        self._best = self.places.copy()

    def go_halfway(self) -> None:
        """Take half of the last step back."""
        self._part *= 0.5
        self.places.put(slice(None), self._before)
        put_solution(Unknowns.POSE, self.places, np.arange(len(self._moves)), self._part * self._moves[:, :, None])

    def go_to_best(self) -> None:
        """Return to where it was best."""
        self.places.put(slice(None), self._best)

    def for_robot(self, robot: int, numbers: Array) -> tuple[NDArray[np.bool_], Array]:
        """What a robot before is sent: which of its poses are tied to the anchor, and their numbers. Of the others
        nothing is said again."""
        rows = self._brought[robot]
        known = self.front.reached[rows]
        self._brought = {**self._brought, robot: rows[known]}
        self._labels = {**self._labels, robot: self._labels[robot][known]}
        return known, numbers[rows[known]]

    # -- poses that share a frame already ----------------------------------------------------------------------------

    def take_places(self, from_below: Mapping[NodeId, Array]) -> None:
        """Places of guests, sent by robots before."""
        me = self.front.nodes[0].robot
        for node, numbers in from_below.items():
            if node.robot != me and node in self.front.row:
                put_sent(Unknowns.KNOWN, self.places, np.array([self.front.row[node]]), numbers[None])

    def sent_places(self, from_below: Mapping[NodeId, Array]) -> dict[NodeId, Array]:
        """Of the poses that go on, those that robots to come cannot know: own ones, and what was sent."""
        front, me = self.front, self.front.nodes[0].robot
        own = [k for k in front.outer.tolist() if front.nodes[k].robot == me]
        numbers = sent(Unknowns.KNOWN, self.places, np.array(own, dtype=np.intp))
        out = {front.nodes[k]: v for k, v in zip(own, numbers, strict=True)}
        return {**out, **{n: v for n, v in from_below.items() if n in front.boundary.nodes}}
