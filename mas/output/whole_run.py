"""All files of a run that has ended, and the rows of its time line."""

from __future__ import annotations

from collections.abc import Sequence

from maslam._replaced import replaced

from ..agent import Agent
from ..evaluation.georeference import datum_of, georeferences, position_figures
from ..evaluation.ground_truth import GroundTruthEvaluator, groups_of
from ..evaluation.summarise import FinishedRun, summarise
from ..evaluation.summary import Summary
from ..manifest import Manifest
from ..protocol.accounting import Traffic
from ..transport.transport import Transport
from .run_folder import Recorder, match_errors


def record_run(
    recorder: Recorder, manifest: Manifest, finished: FinishedRun, evaluator: GroundTruthEvaluator
) -> Summary:
    """Write what a finished run has brought, but for the time line, the traffic and the wall times; returns its
    summary."""
    agents, sequences, config = finished.agents, finished.sequences, finished.config
    errors = match_errors(agents, evaluator)
    recorder.settings(config, manifest)
    recorder.events(finished.events)
    recorder.matches(agents, errors)
    on_earth, datum = georeferences(agents), datum_of(manifest)
    places = {me: one.T_E_F for one in on_earth for me in one.figures.agents}
    for me in range(len(agents)):
        recorder.agent(me, agents, sequences)
        recorder.georeferenced(me, agents, sequences, places.get(me), datum)
    summary = summarise(finished, evaluator, errors)
    first = 0 if summary.earlier is None else summary.earlier.agents
    ends_ns = [s.keyframe_stamps_ns[-1] for s in sequences[first:] if len(s.keyframe_stamps_ns)]
    duration = float(max(ends_ns, default=0)) / 1e9
    summary = replaced(summary, duration_s=duration, positions=position_figures(on_earth, datum, config))
    recorder.summary(summary)
    return summary


def timeline_row(
    number: int, now_ns: int, agents: Sequence[Agent], transport: Transport, evaluator: GroundTruthEvaluator
) -> list[object]:
    """The row of ``timeline.csv`` for a step; errors are empty without truth."""
    own = [evaluator.keyframe_error(a) for a in agents]
    maps = [evaluator.map_error(a) for a in agents]
    accepted = len({m for a in agents for m in a.state.accepted})
    counts = [transport.by_operation[t] for t in Traffic]
    return [
        number,
        now_ns / 1e9,
        sum(len(a.state.keyframes) for a in agents),
        len(groups_of(agents)),
        accepted,
        *(None if e is None else e.rmse_m for e in own),
        *(None if e is None else e.rmse_m for e in maps),
        *(value for c in counts for value in (c.payload_bytes, c.wire_bytes)),
    ]
