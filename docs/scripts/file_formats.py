"""What stands in the files of a SEQS and a RUN folder: tables from the models where there is one, else from the texts
below, which a test holds against the files as they are written.
"""

from __future__ import annotations

import inspect
import re
import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from maslam.mas.evaluation.summary import Summary, Timing
from maslam.mas.manifest import Manifest

MATCHES = {
    "time_s": "logical time at which the candidate was found, seconds",
    "query_agent": "agent whose key-frame was asked about",
    "query_keyframe": "its key-frame, counted from 0",
    "query_stamp_ns": "time stamp of that key-frame in the source's clock, nanoseconds",
    "match_agent": "agent that recognised it; the same agent: an own loop",
    "match_keyframe": "the key-frame recognised",
    "match_stamp_ns": "its time stamp, nanoseconds",
    "same_image": "1: both key-frames are of one and the same image, which two agents were given: no evidence; else 0",
    "wider": "1: beyond the strict distance, considered because the two agents or tracks were not in one frame; else 0",
    "distance": "Euclidean distance of the place vectors, 0 to 2; empty where nobody compared them",
    "outcome": "`accepted`, `rejected`, or `skipped`: not checked",
    "reason": "why, in one of a few fixed wordings; `summary.json` counts by it",
    "detail": "the same with the figures of this candidate",
    "matches": "tentative point matches of the verification",
    "inliers": "those that agree with the pose found",
    "rmse": "root mean square of the inliers' residuals, in standard deviations of the measurements",
    "tx": "translation of `T_M_Q`, in the match agent's unit",
    "ty": "",
    "tz": "",
    "qw": "rotation of `T_M_Q` as a unit quaternion",
    "qx": "",
    "qy": "",
    "qz": "",
    "scale": "scale of `T_M_Q`; 1 between metric agents",
    "error_m": "position error of `T_M_Q` against ground truth, metres; empty without ground truth",
    "error_deg": "rotation error, degrees",
    "false": "1: accepted, but contradicted by ground truth; empty where that cannot be known",
}
TRAFFIC = {
    "time_s": "logical time of sending, seconds",
    "sender": "agent",
    "recipient": "agent",
    "operation": "`dvpr`, `relpose`, `dopt`, `mapmerge` or `negotiation`",
    "kind": "type of the message, or of the task or outcome in it",
    "payload_bytes": "bytes that published tables count",
    "wire_bytes": "exact length of the encoded message, headers included",
}
TIMELINE = {
    "step": "number of the step, from 0",
    "time_s": "logical time, seconds",
    "keyframes": "key-frames seen so far by all agents",
    "groups": "coordinate frames: agents that no match joins count one each",
    "accepted_matches": "matches in use",
    "ate_rmse_m_agent_NN": "RMSE of position of the agent's trajectory so far, under its own alignment, metres",
    "map_rmse_m_agent_NN": "the same of its key-frames and all copies that it holds, together",
    "OPERATION_payload_bytes": "payload sent so far, all agents; one column for each operation of `traffic.csv`",
    "OPERATION_wire_bytes": "bytes sent so far",
}
EVENTS = {
    "contract": "a contract ended: `operation`, `contract` (manager:number), `contractor`, `end` (its last state), "
    "`reason`",
    "match": "a match was accepted: `match`, `inliers`",
    "group": "the agents known to share a frame: `members`",
    "optimised": "an optimisation ended at its manager: `members`, `matches`, `sweeps`, `improved`, `reason`, "
    "`cost_before`, `cost_after`",
    "updated": "the elected agent took later matches in: `corrected` (agents that were sent new poses), `cost`, and at "
    "best `optimum`",
    "updates_ended": "the next match needs an optimisation: `reason`",
    "no_updates": "an optimisation that no updates can follow: `reason`",
    "peer_to_peer": "a member offers matches with the manager alone: `bidder`",
    "map_bought": "a map copy came in: `seller`, `owner`, `version`, `keyframes`, `new_keyframes`, `points`, `route`",
    "map_checked": "a held copy was compared with place matches: `owner`, `version`, `final`, matches and distances",
    "undecided": "at the elected agent: the `rejected` matches would hold if `agents` stood elsewhere, and the `kept` "
    "ones would break: nothing tells which are wrong",
    "optimisation_refused": "a solution was not adopted, as odometry speaks against it: `reason`, `members`, `by` (who "
    "spoilt it, where that is known)",
    "optimisation_left": "a member left an optimisation that got no further, poses as before: `members`, `reason`",
    "map_refused": "a copy was rejected: `seller`, `owner`, `version`, `reason`",
    "contradicted": "matches contradicted by the other matches of a group: `reported_by`, `matches`",
    "reputation": "the reputation of another agent changed: `of`, `trust`, `reliability`, `consistency`, `silent`",
    "refused": "a message was refused: `sender`, `reason`",
}
VO_FILES = {
    "poses_K.txt": "16 numbers a row: `T_W_C` of key-frame i, 4x4, row by row",
    "times_K.txt": "time stamp of key-frame i, seconds",
    "lm_pos_K.txt": "3 numbers a row: map point j in the track's world frame",
    "lm_obs_K.txt": "key-frame index, map-point index of each observation, both from 0",
    "descs_K.txt": "32 bytes of the observation's ORB descriptor, then its vocabulary nodes at levels 3 and 4; rows "
    "as in `lm_obs`",
}
TRAJECTORIES = {
    "trajectory.tum": "every frame that has a place: `time tx ty tz qx qy qz qw`, `T_W_C`; times are the images' own "
    "(`--times agent`: from the agent's start)",
    "trajectory_keyframes.tum": "the same, key-frames only",
    "trajectory_enu.tum": "the same as `trajectory.tum`, metres east, north and up of the datum in `summary.json` "
    "(`positions`); only with positions (GPS) that tell where the map lies",
    "trajectory_geodetic.csv": "`time_s,latitude_deg,longitude_deg,altitude_m` of every frame in it (WGS 84, above the "
    "ellipsoid); only where positions were given in degrees",
    "groundtruth.tum": "the same, ground truth where it is known",
    "graph.g2o": "the agent's pose graph: its poses, its odometry, its matches; node ids name agent and key-frame",
    "agent.msgpack": "what the agent knows at the end, for a later run (`--onto`): poses and units, tracks, verified "
    "matches, what it asked and was asked, compact copies of maps (MessagePack, `maslam.mas.output.saved_agent`)",
    "map.ply": "own map and all copies merged: `x y z`, colour by owner, `agent`",
    "maps/agent_NN.tum, .ply": "the copy of another agent's map: key-frames, points",
    "maps/colmap/": "the merged map as a COLMAP model: `cameras.bin`, `images.bin`, `points3D.bin`; images have the "
    "names of their files, from the data set's folder on, and points every view that was found, where it was measured; "
    "a point lies where its views see it best, and what one image alone sees is a pixel without a point",
}
_ROLE = re.compile(r":(?:class|func|mod|meth|data|attr):`~?([^`]+)`")


def page() -> str:
    """The page."""
    parts = [
        "# Files",
        "Folders and their files; `NN` is an agent's number, `K` the number of a track. The same command gives the "
        "same bytes, but for `timing.json` and the times that the report shows.",
        "## The SEQS folder",
        "Written by `maslam preprocess`, and by `maslam slam` as `OUT/sequences`.",
        "### manifest.json",
        _model(Manifest),
        "### The five VO files",
        "One set a track; ASCII, separated by blanks. The layout is that of dslam_open.",
        _table("file", VO_FILES),
        "### views_K.npz",
        "Where the key-frames of track K see its points, for programs that want pixels; no agent reads it, and other "
        "front ends need not write it. `observations` (N, 2) int32: key-frame and map point as in `lm_obs_K.txt`, all "
        "of those and further ones; `uv` (N, 2) float32: pixels of the pinhole camera, the first's centre at (0, 0), "
        "outside the image by a tenth of its size at most.",
        "### netvlad.npz",
        "numpy arrays: `vectors` (K, dim) float32 unit rows, `textured` (K,) bool, `stamps_ns` (K,) int64, `images` "
        "(file names), `name` and `sha256` of the model, `dim`.",
        "## The RUN folder",
        "Written by `maslam run` and `maslam slam`. `summary.json` comes last: a folder without it is not a finished "
        "run.",
        "### summary.json",
        _model(Summary),
        "### timing.json",
        _model(Timing),
        "### timeline.csv",
        "One row a step.",
        _table("column", TIMELINE),
        "### matches.csv",
        "One row a candidate match.",
        _table("column", MATCHES),
        "### traffic.csv",
        "One row a message.",
        _table("column", TRAFFIC),
        "### events.jsonl",
        "One JSON object a line: `time_s` (logical time, seconds), `agent`, `event` and the fields of that kind.",
        _table("event", EVENTS),
        "### config.yaml",
        "Every setting of the run; `--config config.yaml` repeats it. The keys are those of [Settings](settings.md).",
        "### agent_NN",
        _table("file", TRAJECTORIES),
    ]
    return "\n\n".join(parts) + "\n"


def _table(head: str, rows: dict[str, str]) -> str:
    lines = [f"| {head} | meaning |", "|---|---|", *(f"| `{name}` | {meaning} |" for name, meaning in rows.items())]
    return "\n".join(lines)


def _model(model: type[BaseModel]) -> str:
    """A model's docstring and its keys, then those of the models in it."""
    parts = [_prose(model), _fields(model)]
    for inner in dict.fromkeys(_inner(model)):
        parts += [f"#### {_title(inner)}", _prose(inner), _fields(inner)]
    return "\n\n".join(part for part in parts if part)


def _fields(model: type[BaseModel]) -> str:
    lines = ["| key | type | meaning |", "|---|---|---|"]
    for name, field in model.model_fields.items():
        meaning = (field.description or "").replace("|", "\\|")
        lines.append(f"| `{name}` | {_type(field.annotation)} | {meaning} |")
    return "\n".join(lines)


def _inner(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    for field in model.model_fields.values():
        for one in _models(field.annotation):
            yield one
            yield from _inner(one)


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in typing.get_args(annotation):
        yield from _models(argument)


def _type(annotation: Any) -> str:
    text = str(annotation) if typing.get_args(annotation) else getattr(annotation, "__name__", str(annotation))
    text = re.sub(r"\b[\w.]+\.(\w+)", r"\1", text)
    for model in dict.fromkeys(_models(annotation)):
        text = re.sub(rf"\b{model.__name__}\b", _title(model), text)
    return text.replace("|", "or").replace("NoneType", "null").replace("None", "null")


def _title(model: type[BaseModel]) -> str:
    """``MatchFigures`` is "match figures"."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", model.__name__).lower()


def _prose(model: type[BaseModel]) -> str:
    text = inspect.cleandoc(vars(model).get("__doc__") or "")
    return re.sub(r"``([^`]+)``", r"`\1`", _ROLE.sub(lambda found: f"`{found.group(1)}`", text))
