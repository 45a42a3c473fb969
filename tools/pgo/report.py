"""Report of an optimisation, as text and as JSON."""

from __future__ import annotations

from dataclasses import dataclass, field

from maslam.backend.pose_graph.node import robot_name

from .undecided import UndecidedRecord, undecided_lines
from .updates import lines


@dataclass(frozen=True)
class PgoReport:
    """Costs by convention (docs/appendix/backend.md) of all edges but the rejected ones; centrally nothing is sent.

    ``certified``: whether the minimised cost is proven to be the global optimum's; ``gap``: the share by which it may
    be above it at most; both None where they were not asked for, or there is no proof (cost E). ``rotation_sweeps`` and
    ``pose_sweeps`` are None for methods without sweeps; ``iterations`` is their sum, or the solver's own.
    ``rejected``: each edge that robust selection turned down, and why; ``undecided``: edges kept that as many rejected
    ones contradict (:mod:`maslam.tools.pgo.undecided`). ``warnings``: irregularities of the graph.
    ``monocular``: robots whose units of length were estimated, one for each pose; ``units``: the smallest and largest
    of them in the common one, which the graph is written in; None where there are none. ``lengths``: what robots'
    odometry was found to have to be multiplied by, ``turns_deg_m``: by how much more it is to turn
    about each axis, degrees a metre; the edges are written with both. ``refused``: why robots kept
    their poses as they were, None where all took the result. ``files``: those that were read; ``settings``: what the
    command line asked for, by name.
    ``updates``: of matches one by one, what each cost (:mod:`maslam.tools.pgo.updates`); None where all came at once.
    """

    method: str
    robust: str
    minimised: str
    cost: dict[str, float]
    initial_cost: dict[str, float]
    certified: bool | None
    gap: float | None
    iterations: int
    rotation_sweeps: int | None
    pose_sweeps: int | None
    payload_bytes: int
    wire_bytes: int
    messages: int
    seconds: float
    robots: int
    poses: int
    edges: int
    separator_edges: int
    rejected_edges: int
    unreached_poses: int
    rejected: list[dict[str, object]] = field(default_factory=list)
    undecided: list[UndecidedRecord] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    monocular: list[int] = field(default_factory=list)
    units: dict[str, float] | None = None
    lengths: dict[str, float] = field(default_factory=dict)
    turns_deg_m: dict[str, list[float]] = field(default_factory=dict)
    refused: str | None = None
    files: list[str] = field(default_factory=list)
    settings: dict[str, object] = field(default_factory=dict)
    updates: dict[str, object] | None = None

    def lines(self) -> list[str]:
        """For people."""
        head = f"{self.method}: {self.robots} robots, {self.poses} poses, {self.edges} edges"
        out = [f"{head}, {self.separator_edges} between robots"]
        out += [f"  note: {warning}" for warning in self.warnings]
        for name in self.cost:
            mark = "  (minimised)" if name == self.minimised else ""
            out.append(f"  {name}  {self.initial_cost[name]:.6g} -> {self.cost[name]:.9g}{mark}")
        if self.refused is not None:
            out.append(f"  result refused, poses as they were: {self.refused}")
        out += self._proof() + self._effort()
        out += [] if self.updates is None else lines(self.updates)
        out += self._units()
        if self.lengths:
            each = ", ".join(f"robot {robot} x {factor:.4f}" for robot, factor in self.lengths.items())
            out.append(f"  odometry's lengths are off, and are written corrected: {each}")
        if self.turns_deg_m:
            rates = (f"robot {r} by {' '.join(f'{x:+.4f}' for x in turn)}" for r, turn in self.turns_deg_m.items())
            out.append(f"  odometry turns evenly, and is written corrected, degrees a metre: {', '.join(rates)}")
        if self.robust != "none" and self.robust not in ("huber", "cauchy"):
            out.append(f"  {self.rejected_edges} edges rejected by {self.robust}; --json lists them")
            out += undecided_lines(self.undecided)
        if self.unreached_poses:
            out.append(f"  {self.unreached_poses} poses are joined to the anchor by no edge and stay")
        return out

    def _units(self) -> list[str]:
        """That units were estimated: the graph is in one unit, and no longer in those of the input."""
        if self.units is None:
            return []
        whose = f"robot{'s'[len(self.monocular) == 1 :]} {', '.join(map(robot_name, self.monocular))}"
        metric = self.robots > len(self.monocular)
        common = "that of the other robots" if metric else "that of the first pose"
        sizes = f"{self.units['smallest']:.4g} to {self.units['largest']:.4g}"
        out = [f"  units of length estimated for {whose}: {sizes}, in {common}, which the result is in throughout"]
        if self.method not in ("central", "elected", "multifrontal"):
            out.append(
                "  with units, sweeps take many rounds to the optimum: elected, multifrontal and central reach it"
            )
        return out

    def _proof(self) -> list[str]:
        if self.certified:
            return ["  globally optimal: certified"]
        if self.gap is not None:
            return [f"  at most {100 * self.gap:.3g} % above the global optimum"]
        return [] if self.certified is None else ["  not certified as the global optimum"]

    def _effort(self) -> list[str]:
        if not self.messages:
            return [f"  {self.iterations} iterations, {self.seconds:.2f} s"]
        if self.rotation_sweeps is None:
            how = f"{self.iterations} iterations"
        elif self.rotation_sweeps:
            how = f"{self.rotation_sweeps} rotation and {self.pose_sweeps} pose sweeps"
        else:
            how = f"{self.pose_sweeps} {'passes' if self.method == 'multifrontal' else 'sweeps'}"
        traffic = f"{self.payload_bytes} bytes of poses, {self.wire_bytes} in {self.messages} messages"
        return [f"  {how}, {traffic}, {self.seconds:.2f} s"]
