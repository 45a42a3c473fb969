"""Two key-frames compared: what the query sends of its view, the verdict, and the answer (thesis section 3.5)."""

from __future__ import annotations

import numpy as np

from maslam._replaced import replaced
from maslam.backend.relpose.point_coding import pack_points, unpack_points, worth_sending
from maslam.backend.relpose.verification import PlaceView, Verdict, promising, relative_pose

from ..protocol.ids import REASON_LENGTH, MatchId
from ..protocol.tasks import VerifyAnswer, VerifyTask
from ..protocol.tensors import Tensor, pack_information, pack_poses, pack_sim3
from ..state.agent_state import AgentState
from ..state.keyframe import KeyFrame
from ..state.place_match import MatchEnd


def match_end(state: AgentState, keyframe: KeyFrame) -> MatchEnd:
    """This agent's end of a match."""
    return MatchEnd(keyframe.track, keyframe.T_T_C, state.travelled[keyframe.index])


def verify(state: AgentState, match: MatchId, query: PlaceView, mine: KeyFrame, first: bool = False) -> Verdict:
    """The geometric check with a generator that belongs to this match: no order of events changes the verdict.

    ``first``: the view has only its first points, and must be the surer.
    """
    seed = [state.config.seed, match.query_agent, match.query, match.match_agent, match.match]
    config = state.config.relpose
    inlier_deg = max(config.inlier_angle_deg, config.inlier_px * state.profile.pixel_deg)
    config = replaced(config, inlier_angle_deg=min(inlier_deg, config.search_angle_deg))
    if first and config.min_evidence is not None:
        surer = max(config.min_evidence, state.config.places.first_evidence)
        config = replaced(config, min_evidence=surer)
    return relative_pose(query, view_of(state, mine), config, np.random.default_rng(seed))


def view_of(state: AgentState, keyframe: KeyFrame) -> PlaceView:
    """A key-frame as verification sees it: all its points, with what this system compares."""
    points = keyframe.points_C.astype(np.float64)
    if state.config.places.features == "words":
        return PlaceView(points, words=keyframe.words, metric=state.profile.metric)
    return PlaceView(points, descriptors=keyframe.descriptors, metric=state.profile.metric)


def kind_of(reason: str) -> str:
    """A reason without its figures, to count by."""
    return reason.partition(":")[0]


def task_of(state: AgentState, match: MatchId, rest: bool) -> VerifyTask:
    """The query's points, the most telling first; ``rest``: those that were kept back at first."""
    keyframe, places = state.keyframes[match.query], state.config.places
    points = keyframe.points_C.astype(np.float64)
    # No grid holds what lies behind the camera, and no camera saw it there.
    in_front = np.flatnonzero(points[:, 2] > 0)
    rows = in_front[worth_sending(points[in_front], keyframe.descriptors[in_front], places.max_points)]
    first = min(places.first_points, len(rows)) if places.first_points else len(rows)
    sent = rows[first:] if rest else rows[:first]
    words = places.features == "words"
    ranges, codes = pack_points(points[sent]) if places.point_code == "grid" else (None, None)
    return VerifyTask(
        match=match,
        track=keyframe.track,
        stamp_ns=keyframe.stamp_ns,
        recording=keyframe.recording,
        metric=state.profile.metric,
        T_T_Q=pack_poses(keyframe.T_T_C),
        way=state.travelled[keyframe.index],
        points=Tensor.of(points[sent], "<f4") if codes is None else Tensor.of(codes, "<u4"),
        descriptors=None if words else Tensor.of(keyframe.descriptors[sent, : places.descriptor_bytes], "|u1"),
        words=Tensor.of(keyframe.words[sent], "<u2") if words else None,
        ranges=None if ranges is None else Tensor.of(ranges, "<f4"),
        more=0 if rest else len(rows) - first,
        rest=rest,
    )


def view_of_task(task: VerifyTask) -> PlaceView:
    """The view that a task brings."""
    if task.ranges is None:
        points = task.points.array().astype(np.float64)
    else:
        points = unpack_points(task.ranges.array(), task.points.array())
    if task.words is not None:
        return PlaceView(points, words=task.words.array().astype(np.int32), metric=task.metric)
    assert task.descriptors is not None
    return PlaceView(points, descriptors=task.descriptors.array(), metric=task.metric)


def descriptor_width(view: PlaceView) -> int:
    """Bytes of a point's descriptor, 0 where it has a word."""
    return 0 if view.descriptors is None else int(view.descriptors.shape[1])


def answer_to(state: AgentState, task: VerifyTask, mine: KeyFrame, verdict: Verdict) -> VerifyAnswer:
    """The verdict as the manager gets it."""
    good = verdict.accepted
    information = None
    if good and verdict.full_information is not None:
        with_scale = verdict.full_information[6, 6] > 0
        information = pack_information(verdict.full_information if with_scale else verdict.full_information[:6, :6])
    return VerifyAnswer(
        match=task.match,
        accepted=good,
        reason=verdict.reason[:REASON_LENGTH],
        matches=verdict.matches,
        inliers=verdict.inliers,
        rmse=float(verdict.rmse) if np.isfinite(verdict.rmse) else None,
        T_M_Q=pack_sim3(verdict.T_M_Q) if verdict.T_M_Q is not None else None,
        information=information,
        track=mine.track,
        stamp_ns=mine.stamp_ns,
        T_T_M=pack_poses(mine.T_T_C),
        way=state.travelled[mine.index],
        depth=mine.depth,
        keyframes=len(state.keyframes),
        wants_more=bool(task.more) and promising(verdict),
    )
