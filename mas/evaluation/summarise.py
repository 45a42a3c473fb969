"""From agents to figures: the summary of a run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from maslam.backend.trajectory_error import TrajectoryError

from ..agent import Agent
from ..config import MasConfig
from ..contracts.effects import Event
from ..manifest import LeftOutEntry
from ..protocol.ids import MatchId
from ..sequence import AgentSequence
from ..state.place_match import MatchOutcome
from ..state.trajectories import frame_trajectory
from ..transport.transport import TrafficCount, Transport
from .coverage import coverage_of, one_frame
from .earlier_map import EarlierMap
from .graph_fit import graph_figures
from .ground_truth import GroundTruthEvaluator, MatchError, groups_of, of_same_image
from .load_figures import load_of
from .map_copies import map_copies
from .odometry_error import odometry_error
from .reputation_figures import fault_figures, reputations
from .summary import (
    Alignments,
    Errors,
    MatchFigures,
    MeasuredOn,
    OptimisationFigures,
    Summary,
    TrafficFigures,
)
from .truth_fit import truth_figures
from .undecided_figures import undecided_of


@dataclass(frozen=True)
class FinishedRun:
    """A run at its end: agents with their sequences, the transport with its counts, the event log; ``left_out``:
    sequences without an agent; ``earlier``: the map of the run that it was made onto."""

    agents: Sequence[Agent]
    sequences: Sequence[AgentSequence]
    config: MasConfig
    transport: Transport
    events: Sequence[Event]
    steps: int
    left_out: Sequence[LeftOutEntry] = ()
    earlier: EarlierMap | None = None


def summarise(run: FinishedRun, evaluator: GroundTruthEvaluator, errors: dict[MatchId, MatchError]) -> Summary:
    """All figures but the wall times, which are 0."""
    agents, sequences, config, transport = run.agents, run.sequences, run.config, run.transport
    own = [
        evaluator.error_of(a.state.me, frame_trajectory(a.state, s), evaluator.placed_with_scale(a.state))
        for a, s in zip(agents, sequences, strict=True)
    ]
    odometry = [odometry_error(a, s, evaluator) for a, s in zip(agents, sequences, strict=True)]
    maps = [evaluator.map_error(a) for a in agents]
    connected = evaluator.connected_errors(agents)
    columns = (own, maps, [connected.get(a.state.me) for a in agents])
    placed = [evaluator.placed_with_scale(a.state) for a in agents]
    rmse = [None if e is None else e.rmse_m for e in odometry]
    coverage, groups = [coverage_of(a, s) for a, s in zip(agents, sequences, strict=True)], groups_of(agents)
    left_out = [one.sequence for one in run.left_out]
    traffic = {t.value: _traffic([count]) for t, count in transport.by_operation.items()}
    return Summary(
        version=_version(),
        preset=config.preset,
        policy=config.policy,
        seed=config.seed,
        place_code=agents[0].state.profile.coder.key,
        place_code_bytes=agents[0].state.profile.coder.bytes,
        scale="arbitrary" if all(placed) else "mixed" if any(placed) else "metric",
        times=config.times,
        agents=len(agents),
        keyframes=sum(len(a.state.keyframes) for a in agents),
        keyframes_placed=[len(a.state.placed()) for a in agents],
        duration_s=0.0,
        steps=run.steps,
        groups=groups,
        one_frame=one_frame(groups, [s.name for s in sequences], [c.placed for c in coverage], left_out),
        ate_rmse_m=_errors(columns, "rmse_m"),
        ate_mean_m=_errors(columns, "mean_m"),
        odometry_rmse_m=rmse,
        odometry_mean_rmse_m=_mean(rmse),
        path_length_m=[evaluator.path_length_m(a) for a in agents],
        exploration_percent=[evaluator.exploration_percent(a) for a in agents],
        alignments=Alignments(
            agents=_alignments(own, placed),
            maps=_alignments(maps, placed),
            connected=_alignments(columns[2], placed),
            odometry=[None if e is None else e.on for e in odometry],
        ),
        coverage=coverage,
        left_out=list(run.left_out),
        traffic={**traffic, "total": _traffic(list(transport.by_operation.values()))},
        matches=_matches(agents, errors, any(s.groundtruth is not None for s in sequences), transport),
        optimisations=_optimisations(run.events, agents),
        graphs=graph_figures(agents),
        truths=truth_figures(sequences),
        map_copies=map_copies(agents, [evaluator.copy_errors(a) for a in agents]),
        earlier=None if run.earlier is None else run.earlier.figures(agents),
        load=load_of(len(agents), transport, run.events),
        refused_messages=sum(r.refused for a in agents for r in a.context.reputation.records.values()),
        reputation=reputations(agents),
        faults=fault_figures(agents, transport),
    )


def _errors(columns: tuple[list[TrajectoryError | None], ...], name: str) -> Errors:
    own, maps, connected = ([None if e is None else float(getattr(e, name)) for e in column] for column in columns)
    return Errors(agents=own, maps=maps, connected=connected, mean_agents=_mean(own), mean_maps=_mean(maps))


def _alignments(errors: Sequence[TrajectoryError | None], with_scale: Sequence[bool]) -> list[MeasuredOn | None]:
    return [
        None if e is None else MeasuredOn(kind=k, scale=float(e.T_truth_estimate.scale), frames=len(e.errors_m))
        for e, k in zip(errors, ("Sim(3)" if scaled else "SE(3)" for scaled in with_scale), strict=True)
    ]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None


def _traffic(counts: Sequence[TrafficCount]) -> TrafficFigures:
    return TrafficFigures(
        messages=sum(c.messages for c in counts),
        payload_bytes=sum(c.payload_bytes for c in counts),
        wire_bytes=sum(c.wire_bytes for c in counts),
    )


def _matches(
    agents: Sequence[Agent], errors: dict[MatchId, MatchError], truth: bool, transport: Transport
) -> MatchFigures:
    outcomes = [(agent, c, agent.candidates.outcome_of(c)) for agent in agents for c in agent.candidates.by_id.values()]
    accepted = [c.id for _, c, (outcome, _) in outcomes if outcome is MatchOutcome.ACCEPTED]
    reasons = {kind: Counter(str(why) for _, _, (outcome, why) in outcomes if outcome is kind) for kind in MatchOutcome}
    own, known = sum(m.query_agent == m.match_agent for m in accepted), [m for m in accepted if m in errors]
    return MatchFigures(
        candidates=len(outcomes),
        verified=sum(c.check.verified for _, c, _ in outcomes),
        accepted=len(accepted),
        rejected=dict(sorted(reasons[MatchOutcome.REJECTED].items())),
        skipped=dict(sorted(reasons[MatchOutcome.SKIPPED].items())),
        same_image=sum(of_same_image(c.id, agents) for _, c, _ in outcomes),
        wider=sum(c.wider for _, c, (outcome, _) in outcomes if outcome is not MatchOutcome.SKIPPED),
        wider_accepted=sum(c.wider for _, c, (outcome, _) in outcomes if outcome is MatchOutcome.ACCEPTED),
        wider_traffic=_traffic([transport.by_contract[i] for a in agents for i in sorted(a.places.verification.wider)]),
        own_loops=own,
        between_agents=len(accepted) - own,
        # Without the truth at both ends of any of them there is nothing to be said.
        false_accepted=sum(errors[m].false for m in known) if truth and (known or not accepted) else None,
    )


def _optimisations(events: Sequence[Event], agents: Sequence[Agent]) -> OptimisationFigures:
    in_order = sorted(events, key=lambda e: e.agent)  # sums of floating-point numbers depend on it
    done = [e.fields for e in in_order if e.kind == "optimised"]
    return OptimisationFigures(
        count=len(done),
        updates=sum(e.kind == "updated" for e in events),
        iterations=sum(d["sweeps"] for d in done),
        cost_before=float(sum(d["cost_before"] for d in done)),
        cost_after=float(sum(d["cost_after"] for d in done)),
        undecided=undecided_of(agents),
    )


def _version() -> str:
    try:
        return version("maslam")
    except PackageNotFoundError:
        return "unknown"
