"""The RUN folder: everything about a run, written aside and moved into place whole at the end.

The same run gives the same bytes; how long it took stands apart, in ``timing.json``.
"""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
from collections.abc import Iterable, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
import yaml

from maslam.backend.geometry import Sim3
from maslam.backend.pose_graph.g2o import write_g2o
from maslam.frontend.files.trajectory import Trajectory, write_tum

from ..agent import Agent
from ..config import MasConfig
from ..contracts.effects import Event
from ..errors import MasError
from ..evaluation.ground_truth import GroundTruthEvaluator, MatchError, of_same_image
from ..evaluation.summary import DatumFigures, Summary, Timing
from ..manifest import MANIFEST, CameraEntry, Manifest
from ..map_exchange.full_map import own_map
from ..protocol.accounting import Traffic
from ..protocol.ids import MatchId
from ..sequence import GROUNDTRUTH, AgentSequence
from ..state.place_match import MatchOutcome
from ..state.pose_graph import own_graph
from ..state.trajectories import frame_trajectory, keyframe_trajectory
from ..transport.transport import Sent
from .colmap import write_colmap
from .fused_map import fused, write_map, write_ply
from .georeferenced import write_georeferenced
from .saved_agent import SAVED, write_saved
from .sightings import MapOwner, map_owner

SUMMARY = "summary.json"
TIMING = "timing.json"
_EARLIER = "summary.json.old"  # an earlier run's, while its files are being replaced
_OURS = re.compile(r"agent_\d+|(config|manifest|events|matches|traffic|timeline|timing)\.[a-z]+|report|recording\.rrd")
SEQUENCES, EARLIER = "sequences", "earlier"
"""Folders of agent sequences beside a run: its own, and those of the run that it was made onto."""
_BESIDE = {SEQUENCES, EARLIER, "town", "journals"}  # what a command may have put beside a run; left as it is
_MATCH_COLUMNS = [
    "time_s",
    "query_agent",
    "query_keyframe",
    "query_stamp_ns",
    "match_agent",
    "match_keyframe",
    "match_stamp_ns",
    "same_image",
    "wider",
    "distance",
    "outcome",
    "reason",
    "detail",
    "matches",
    "inliers",
    "rmse",
    "tx",
    "ty",
    "tz",
    "qw",
    "qx",
    "qy",
    "qz",
    "scale",
    "error_m",
    "error_deg",
    "false",
]


def check_out(out: Path) -> None:
    """Raise ``MasError`` where a run may not be written to ``out``: an earlier run may be replaced and an empty folder
    filled, anybody else's files may not be touched.
    """
    if not out.exists():
        return
    if not out.is_dir():
        raise MasError(f"{out}: is a file, not a folder")
    names = {path.name for path in out.iterdir()}
    if not (names & {SUMMARY, _EARLIER} or names <= _BESIDE):
        raise MasError(f"{out}: exists and is not an earlier run; choose another folder")


class Recorder:
    """``with Recorder(out) as recorder``: files appear under ``out`` only when the block ends without an exception."""

    def __init__(self, out: Path) -> None:
        self.out = out
        place = out.resolve()  # "." has no name of its own
        self.folder = place.parent / f"{place.name}.part"
        self._files: list[IO[str]] = []
        self._traffic: Any = None
        self._timeline: Any = None
        self._cameras: dict[int, CameraEntry] = {}
        self._owners: dict[int, MapOwner] = {}
        self._of_images = True

    def __enter__(self) -> Recorder:
        check_out(self.out)
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        self._traffic = self._csv("traffic.csv")
        self._traffic.writerow(["time_s", "sender", "recipient", "operation", "kind", "payload_bytes", "wire_bytes"])
        self._timeline = self._csv("timeline.csv")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            for file in self._files:
                with suppress(OSError) if kind is not None else nullcontext():  # a full disk is said once
                    file.close()
            if kind is None:
                self._put_in_place()
        finally:
            shutil.rmtree(self.folder, ignore_errors=True)

    def _put_in_place(self) -> None:
        """Replace an earlier run's files. Its summary goes first, the new one comes last: between, this is no run."""
        self.out.mkdir(parents=True, exist_ok=True)
        if (self.out / SUMMARY).exists():
            os.replace(self.out / SUMMARY, self.out / _EARLIER)
        for old in sorted(path for path in self.out.iterdir() if _OURS.fullmatch(path.name)):
            shutil.rmtree(old) if old.is_dir() else old.unlink()
        for new in sorted(self.folder.iterdir(), key=lambda path: (path.name == SUMMARY, path.name)):
            os.replace(new, self.out / new.name)
        (self.out / _EARLIER).unlink(missing_ok=True)

    # -- while it runs ------------------------------------------------------------------------------------------------

    def sent(self, sent: Sent) -> None:
        """A row of ``traffic.csv``."""
        row = (sent.sender, sent.recipient, sent.operation.value, sent.kind, sent.payload_bytes, sent.wire_bytes)
        self._traffic.writerow((seconds(sent.now_ns), *row))

    def begin_timeline(self, agents: int) -> None:
        """The head of ``timeline.csv``."""
        names = [f"agent_{a:02d}" for a in range(agents)]
        bytes_ = [f"{t.value}_{unit}" for t in Traffic for unit in ("payload_bytes", "wire_bytes")]
        errors = [f"{what}_{name}" for what in ("ate_rmse_m", "map_rmse_m") for name in names]
        self._timeline.writerow(["step", "time_s", "keyframes", "groups", "accepted_matches", *errors, *bytes_])

    def step(self, values: Iterable[Any]) -> None:
        """A row of ``timeline.csv``."""
        self._timeline.writerow([figure(v) for v in values])

    # -- at the end ---------------------------------------------------------------------------------------------------

    def settings(self, config: MasConfig, manifest: Manifest) -> None:
        """``config.yaml`` and the manifest of what was run."""
        self._cameras = {number: entry.camera for number, entry in enumerate(manifest.agents)}
        self._of_images = config.times == "images"
        text = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
        (self.folder / "config.yaml").write_text(text, encoding="utf-8")
        (self.folder / MANIFEST).write_text(manifest.model_dump_json(indent=1) + "\n", encoding="utf-8")

    def events(self, events: Iterable[Event]) -> None:
        """``events.jsonl``, in order of time, then agent."""
        with open(self.folder / "events.jsonl", "w", encoding="utf-8") as out:
            for e in sorted(events, key=lambda e: (e.now_ns, e.agent)):
                line = {"time_s": e.now_ns / 1e9, "agent": e.agent, "event": e.kind, **e.fields}
                out.write(json.dumps(line) + "\n")

    def matches(self, agents: Sequence[Agent], errors: dict[MatchId, MatchError]) -> None:
        """``matches.csv``: each candidate, its outcome and why; against the truth where that is known."""
        table = self._csv("matches.csv")
        table.writerow(_MATCH_COLUMNS)
        for agent in agents:
            for c in agent.candidates.by_id.values():
                outcome, reason = agent.candidates.outcome_of(c)
                i, check, error = c.id, c.check, errors.get(c.id)
                stamps = [_stamp_of(agents[a], k) for a, k in ((i.query_agent, i.query), (i.match_agent, i.match))]
                head = [seconds(c.now_ns), i.query_agent, i.query, stamps[0], i.match_agent, i.match, stamps[1]]
                row = [
                    int(of_same_image(i, agents)),
                    int(c.wider),
                    figure(c.distance),
                    outcome.value,
                    reason,
                    check.detail,
                    check.matches,
                    check.inliers,
                    figure(check.rmse),
                ]
                wrong = int(error.false) if error is not None and outcome is MatchOutcome.ACCEPTED else ""
                truth = [figure(error.metres), figure(error.degrees), wrong] if error is not None else ["", "", ""]
                table.writerow([*head, *row, *_transform(check.T_M_Q), *truth])

    def agent(self, me: int, agents: Sequence[Agent], sequences: Sequence[AgentSequence]) -> None:
        """The folder of agent ``me``: trajectories, graph, own and merged map, copies."""
        folder, agent, sequence = self.folder / f"agent_{me:02d}", agents[me], sequences[me]
        (folder / "maps").mkdir(parents=True)
        start_ns = sequence.start_ns if self._of_images else 0
        write_tum(folder / "trajectory.tum", later(frame_trajectory(agent.state, sequence), start_ns))
        write_tum(folder / "trajectory_keyframes.tum", later(keyframe_trajectory(agent.state), start_ns))
        if sequence.groundtruth is not None:
            write_tum(folder / GROUNDTRUTH, later(sequence.groundtruth, start_ns))
        write_saved(folder / SAVED, agent)
        if not agent.state.keyframes:
            return
        write_g2o(folder / "graph.g2o", own_graph(agent.state))
        copies = [copy for _, copy in sorted(agent.maps.copies.items())]
        one = fused([own_map(agent.state), *copies])
        write_map(folder / "map.ply", one)
        for owner in {m.owner for m in one.maps} - self._owners.keys():
            known = sequences[owner], agents[owner].state.keyframes, self._cameras[owner]
            self._owners[owner] = map_owner(*known)
        write_colmap(folder / "maps" / "colmap", one, self._owners)
        for copy in copies:
            owner, stamps = copy.owner, copy.stamps_ns.astype("int64")
            write_tum(folder / "maps" / f"agent_{owner:02d}.tum", Trajectory(stamps, copy.poses))
            points = copy.points()
            write_ply(folder / "maps" / f"agent_{owner:02d}.ply", points, np.full(len(points), owner))

    def georeferenced(
        self,
        me: int,
        agents: Sequence[Agent],
        sequences: Sequence[AgentSequence],
        T_E_F: Sim3 | None,
        datum: DatumFigures | None,
    ) -> None:
        """The trajectory of agent ``me`` in the frame of the positions (GPS), where that is known."""
        if T_E_F is not None:
            start_ns = sequences[me].start_ns if self._of_images else 0
            trajectory = later(frame_trajectory(agents[me].state, sequences[me]), start_ns)
            write_georeferenced(self.folder / f"agent_{me:02d}", trajectory, T_E_F, datum)

    def summary(self, summary: Summary) -> None:
        """``summary.json``."""
        (self.folder / SUMMARY).write_text(summary.model_dump_json(indent=1) + "\n", encoding="utf-8")

    def timing(self, timing: Timing) -> None:
        """``timing.json``."""
        (self.folder / TIMING).write_text(timing.model_dump_json(indent=1) + "\n", encoding="utf-8")

    def _csv(self, name: str) -> Any:
        file = open(self.folder / name, "w", newline="", encoding="utf-8")  # noqa: SIM115 - closed in __exit__
        self._files.append(file)
        return csv.writer(file, lineterminator="\n")


def _stamp_of(agent: Agent, keyframe: int) -> int | str:
    """Nothing for a key-frame that another agent claims it has, and it has not."""
    keyframes = agent.state.keyframes
    return keyframes[keyframe].stamp_ns if keyframe < len(keyframes) else ""


def later(trajectory: Trajectory, by_ns: int) -> Trajectory:
    """The trajectory with its times moved."""
    return Trajectory(trajectory.stamps_ns + by_ns, trajectory.poses)


def seconds(now_ns: int) -> str:
    """Logical time for tables."""
    return f"{now_ns / 1e9:.3f}"


def figure(value: Any) -> Any:
    """A number short enough to read and long enough to compare; nothing for None."""
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else value


def match_errors(agents: Sequence[Agent], evaluator: GroundTruthEvaluator) -> dict[MatchId, MatchError]:
    """The error of every verified match whose truth is known."""
    errors = {}
    for agent in agents:
        for match in agent.state.verified.values():
            if match.id.query_agent == agent.state.me:
                error = evaluator.match_error(match, agents)
                if error is not None:
                    errors[match.id] = error
    return errors


def _transform(T_M_Q: Any) -> list[Any]:
    if T_M_Q is None:
        return [""] * 8
    from ..protocol.tensors import pack_sim3

    return [figure(float(v)) for v in pack_sim3(T_M_Q).array()]
