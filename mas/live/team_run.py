"""The RUN folder of a team on a network: its agents made anew from their journals, recorded as if simulated."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..config import MasConfig
from ..contracts.effects import Event
from ..evaluation.ground_truth import GroundTruthEvaluator
from ..evaluation.summarise import FinishedRun
from ..evaluation.summary import Summary, Timing
from ..manifest import Manifest
from ..output.run_folder import Recorder
from ..output.whole_run import record_run, timeline_row
from ..sequence import AgentSequence
from ..transport.transport import HandedOver, Transport
from .journal import read_journal
from .one_agent import inputs_of
from .recorded_agent import AgentInputs, Replayed, replay


class SentMessages(Transport):
    """Counts what agents sent, and carries nothing: it has arrived already, or was lost."""

    def carry(self, sender: int, recipient: int, data: bytes) -> None:
        return None

    def arrive(self) -> HandedOver | None:
        return None


@dataclass(frozen=True)
class _Step:
    now_ns: int
    agent: int
    replayed: Replayed


def record_team(
    manifest: Manifest,
    sequences: Sequence[AgentSequence],
    config: MasConfig,
    journals: Sequence[Path],
    out: Path,
    wall_s: float,
    agents_cpu_s: list[float] | None = None,
) -> Summary:
    """Write the RUN folder ``out`` from the journals of all agents, in the order of the sequences. Times are each
    agent's own: they began when their recordings did. ``wall_s``: how long the agents' processes ran;
    ``agents_cpu_s``: CPU time of each."""
    pairs = enumerate(zip(manifest.agents, sequences, strict=True))
    inputs = [inputs_of(me, manifest, entry, sequence, config) for me, (entry, sequence) in pairs]
    agents = [one.agent for one in inputs]
    evaluator = GroundTruthEvaluator(sequences, sum(entry.frames for entry in manifest.left_out))
    events: list[Event] = []
    step_ns, rows = round(config.step_s * 1e9), 0
    transport = SentMessages()
    with Recorder(out) as recorder:
        transport.begin(round(config.max_message_mb * 2**20), recorder.sent)
        recorder.begin_timeline(len(agents))
        for step in _in_order(inputs, journals):
            while step.now_ns >= (rows + 1) * step_ns:
                recorder.step(timeline_row(rows, rows * step_ns, agents, transport, evaluator))
                rows += 1
            events += step.replayed.effects.events
            for message in step.replayed.effects.messages:
                transport.send(message, step.now_ns)
        recorder.step(timeline_row(rows, rows * step_ns, agents, transport, evaluator))
        finished = FinishedRun(agents, sequences, config, transport, events, rows + 1, manifest.left_out)
        summary = record_run(recorder, manifest, finished, evaluator)
        factor = summary.duration_s / wall_s
        recorder.timing(Timing(wall_s=wall_s, realtime_factor=factor, agents_cpu_s=agents_cpu_s))
    return summary


def _in_order(inputs: Sequence[AgentInputs], journals: Sequence[Path]) -> Iterator[_Step]:
    """What happened to all agents, by their own times."""
    streams = [_steps(me, given, journal) for me, (given, journal) in enumerate(zip(inputs, journals, strict=True))]
    return heapq.merge(*streams, key=lambda step: (step.now_ns, step.agent))


def _steps(me: int, inputs: AgentInputs, journal: Path) -> Iterator[_Step]:
    for one in replay(inputs, read_journal(journal), str(journal)):
        yield _Step(one.entry.now_ns, me, one)
