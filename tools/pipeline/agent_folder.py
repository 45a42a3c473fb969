"""Tracked sequences written as agents: the five files, place vectors, trajectories, and the manifest that completes
the folder.
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import replacing
from maslam._replaced import replaced
from maslam.backend.geometry import product, se3_inverse
from maslam.backend.pose_graph.g2o import write_g2o
from maslam.backend.pose_graph.graph import Edge, NodeId, PoseGraph
from maslam.descriptors.base import PlaceDescriptor
from maslam.descriptors.container import PlaceVectors
from maslam.frontend.datasets.base import Dataset, ImageSequence
from maslam.frontend.datasets.numbering import numbers_of
from maslam.frontend.datasets.stored_image import name_in
from maslam.frontend.files.essential_graph import essential_graph
from maslam.frontend.files.point_views import write_views
from maslam.frontend.files.positions import POSITIONS, write_positions
from maslam.frontend.files.trajectory import NS_PER_S, Trajectory, write_tum
from maslam.frontend.files.vo_files import VoTrack, write_track
from maslam.mas.manifest import (
    MANIFEST,
    AgentEntry,
    CameraEntry,
    LeftOutEntry,
    LostEntry,
    Manifest,
    MissingEntry,
    SplitEntry,
    StoredCameraEntry,
    write_manifest,
)
from maslam.mas.sequence import GROUNDTRUTH, PLACES, TRAJECTORY

from ..common.text_table import kinds_text
from .descriptor_entry import descriptor_entry
from .split import SequenceShare, cut_track, cut_views, share_out
from .tracking import Gap, Tracked, unread_kinds

_COMMON = 8  # coefficients of a lens that other programs have a model for


@dataclass(frozen=True)
class SharePlan:
    """One agent to be: its share of a tracked sequence."""

    name: str
    sequence: ImageSequence
    tracked: Tracked
    share: SequenceShare

    @property
    def start_ns(self) -> int:
        """Time stamp of its first frame, in the source."""
        return int(self.sequence.stamps_ns[self.share.first])


def write_sequences(
    out: Path,
    dataset: Dataset,
    plans: Sequence[SharePlan],
    model: PlaceDescriptor,
    split: SplitEntry | None,
    settings: dict[str, Any],
    left_out: tuple[LeftOutEntry, ...] = (),
    scale: Literal["metric", "arbitrary"] | None = None,
    before: Sequence[AgentEntry] = (),
) -> Manifest:
    """Write the SEQS folder ``out``; ``settings`` and the sequences ``left_out`` are noted in its manifest.

    ``scale``: the unit of poses that another system gave; ``before``: agents that the folder holds and keeps.
    """
    if not before:  # what is kept stays whole, whatever becomes of the others
        (out / MANIFEST).unlink(missing_ok=True)
    entries = [*before, *(_write_agent(out, plan, model, dataset.root, scale) for plan in plans)]
    left = {*out.glob("agent_[0-9]*"), *out.glob(".agent_[0-9]*.part")}  # of another split, of a run that was killed
    for stale in sorted(left - {out / entry.name for entry in entries}):
        shutil.rmtree(stale)
    manifest = Manifest(
        source=str(dataset.root.resolve()),
        kind=dataset.kind,
        scale="metric" if any(entry.metric for entry in entries) else "arbitrary",
        descriptor=descriptor_entry(model),
        agents=tuple(entries),
        split=split,
        left_out=left_out,
        settings=settings,
    )
    write_manifest(out, manifest)
    return manifest


def plan_agents(
    tracked: Sequence[tuple[ImageSequence, Tracked]], split: SplitEntry | None, first: int = 0
) -> list[SharePlan]:
    """Share the tracked sequences out to agents numbered from ``first``; who would get no key-frame is left out."""
    split = split or SplitEntry(agents=1, overlap=0)
    shares = [
        (sequence, one, share)
        for sequence, one in tracked
        for share in share_out(len(sequence), list(one.keyframes), split.agents, split.overlap)
    ]
    plans = [SharePlan(f"agent_{agent:02d}", *parts) for agent, parts in enumerate(shares, first)]
    return [plan for plan in plans if any(k.stop > k.start for k in plan.share.keyframes)]


def _write_agent(
    out: Path,
    plan: SharePlan,
    model: PlaceDescriptor,
    root: Path,
    scale: Literal["metric", "arbitrary"] | None,
) -> AgentEntry:
    """The agent's folder, put in place whole; times become relative to its first frame."""
    used = [k for k, keyframes in enumerate(plan.share.keyframes) if keyframes.stop > keyframes.start]
    places = _places(plan, used, model, root)
    with replacing(out / plan.name) as folder:
        folder.mkdir()
        paths = [_write_track(folder, number, plan, k) for number, k in enumerate(used)]
        trajectory = Trajectory(
            np.concatenate([path.stamps_ns for path in paths]), np.concatenate([path.poses for path in paths])
        )
        write_tum(folder / TRAJECTORY, trajectory)
        places.save(folder / PLACES)
        if plan.sequence.positions is not None:
            first, last = plan.sequence.stamps_ns[[plan.share.first, plan.share.last]].tolist()
            write_positions(folder / POSITIONS, plan.sequence.positions.between(first, last, plan.start_ns))
        if plan.sequence.groundtruth is not None:
            write_tum(folder / GROUNDTRUTH, _during(plan, plan.sequence.groundtruth))
    return AgentEntry(
        name=plan.name,
        sequence=plan.sequence.name,
        first_frame=plan.share.first,
        frames=plan.share.last - plan.share.first + 1,
        keyframes=len(places.vectors),
        tracks=len(used),
        start_ns=plan.start_ns,
        camera=CameraEntry.from_rig(plan.sequence.rig, _stored(plan.sequence)),
        lost=with_images(plan, lost_frames(plan, trajectory.stamps_ns + plan.start_ns)),
        doubtful=with_images(plan, _within(plan.share, plan.tracked.doubtful)),
        missing=tuple(
            MissingEntry(after_frame=one.after - plan.share.first, first=one.first, last=one.last, count=one.count)
            for one in plan.sequence.missing
            if plan.share.first <= one.after <= plan.share.last
        ),
        scale=scale,
    )


def stand_in(sequence: ImageSequence) -> str:
    """What to say where :func:`_stored` has no entry for the camera of image files that are not rectified; else
    empty."""
    camera = sequence.stored_camera
    if camera is None or _stored(sequence) is not None:
        return ""
    return (
        f"its lens ({camera.distortion}, {len(camera.coefficients)} coefficients) has no COLMAP model: "
        "maps/colmap has the rectified images' camera, not the files'"
    )


def _stored(sequence: ImageSequence) -> StoredCameraEntry | None:
    """The camera of the image files, where they are not rectified. Lenses of spheres and mirrors, and those with
    thin-prism or tilt coefficients (OpenCV: the 9th to 14th), have no model in most programs: there the rectified
    camera stands for them."""
    camera, rotation = sequence.stored_camera, sequence.R_rectified_left
    if camera is None or rotation is None or any(camera.coefficients[_COMMON:]):
        return None
    if camera.distortion.value not in get_args(StoredCameraEntry.model_fields["distortion"].annotation):
        return None
    return StoredCameraEntry(
        distortion=camera.distortion.value,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        coefficients=camera.coefficients[:_COMMON],
        rotation=tuple(rotation.ravel().tolist()),
    )


def _write_track(folder: Path, number: int, plan: SharePlan, k: int) -> Trajectory:
    """The five files, the views and the essential graph of track ``k`` as the agent's track ``number``; returns all its
    frames, in the same origin and clock.
    """
    kept = plan.share.keyframes[k]
    track = plan.tracked.tracks[k]
    cut = cut_track(track, kept, _keyframe_stamps_ns(plan, k) / NS_PER_S)
    write_track(folder, number, cut)
    if len(plan.tracked.views[k]):  # other front ends' files do not say where points are seen
        write_views(folder, number, cut_views(plan.tracked.views[k], track, kept))
    write_g2o(folder / f"essential_{number}.g2o", _essential(cut), plain_ids=True)
    frames = _during(plan, plan.tracked.trajectories[k])
    return Trajectory(frames.stamps_ns, product(se3_inverse(track.poses[kept.start]), frames.poses))


def _essential(track: VoTrack) -> PoseGraph:
    """The track's essential graph for other programs; node i is key-frame i, unit information as in ORB-SLAM."""
    graph = essential_graph(track)
    nodes = [NodeId(0, k) for k in range(len(track))]
    edges = zip(graph.ends.tolist(), graph.T_i_j, strict=True)
    return PoseGraph(
        dict(zip(nodes, track.poses, strict=True)), tuple(Edge(nodes[i], nodes[j], T_i_j) for (i, j), T_i_j in edges)
    )


def _keyframe_stamps_ns(plan: SharePlan, k: int) -> NDArray[np.int64]:
    return plan.sequence.stamps_ns[plan.tracked.keyframes[k][plan.share.keyframes[k]]] - plan.start_ns


def _places(plan: SharePlan, used: list[int], model: PlaceDescriptor, root: Path) -> PlaceVectors:
    begins = np.cumsum([0, *(len(keyframes) for keyframes in plan.tracked.keyframes)])
    kept = [plan.share.keyframes[k] for k in used]
    rows = np.concatenate([np.arange(begins[k] + s.start, begins[k] + s.stop) for k, s in zip(used, kept, strict=True)])
    return PlaceVectors(
        name=model.name,
        sha256=model.sha256,
        dim=model.dim,
        stamps_ns=np.concatenate([_keyframe_stamps_ns(plan, k) for k in used]),
        vectors=plan.tracked.vectors[rows],
        textured=plan.tracked.textured[rows],
        images=tuple(
            name_in(plan.sequence.left[frame], root)
            for k in used
            for frame in plan.tracked.keyframes[k][plan.share.keyframes[k]].tolist()
        ),
    )


def _during(plan: SharePlan, trajectory: Trajectory) -> Trajectory:
    """The poses between the agent's first and last frame, on its own clock."""
    first, last = plan.sequence.stamps_ns[[plan.share.first, plan.share.last]]
    inside = (trajectory.stamps_ns >= first) & (trajectory.stamps_ns <= last)
    return Trajectory(trajectory.stamps_ns[inside] - plan.start_ns, trajectory.poses[inside])


def lost_frames(plan: SharePlan, placed_ns: NDArray[np.int64]) -> tuple[LostEntry, ...]:
    """The intervals of frames of the agent's block that have no pose at ``placed_ns`` (the source's clock): where
    odometry says why, in its words; the others were not readable, or are of a track without a key-frame here."""
    first, last = plan.share.first, plan.share.last
    stamps = plan.sequence.stamps_ns[first : last + 1]
    kinds = unread_kinds(first, last, plan.tracked.other_size)
    tracked = np.concatenate([t.stamps_ns for t in plan.tracked.trajectories])
    kinds[np.isin(stamps, tracked)] = "tracked, but no key-frame of its track is the agent's"
    gap = np.full(len(stamps), -1)  # intervals of odometry stay apart, also where they touch
    for number, lost in enumerate(plan.tracked.lost):
        inside = slice(max(lost.first_frame - first, 0), max(lost.last_frame + 1 - first, 0))
        of_frames = [kind for kind, frames in lost.kinds for _ in range(frames)]
        of_frames = of_frames or [lost.reason] * (lost.last_frame - lost.first_frame + 1)
        gap[inside], kinds[inside] = number, of_frames[max(first - lost.first_frame, 0) :][: len(kinds[inside])]
    rows = np.flatnonzero(~np.isin(stamps, placed_ns))
    apart = (gap[rows][1:] == -1) & (kinds[rows][1:] != kinds[rows][:-1])
    changes = (np.diff(rows) > 1) | (np.diff(gap[rows]) != 0) | apart
    runs = np.split(rows, np.flatnonzero(changes) + 1) if len(rows) else []
    return tuple(_lost_entry(run, kinds, plan.tracked.lost[gap[run[0]]] if gap[run[0]] >= 0 else None) for run in runs)


def with_images(plan: SharePlan, entries: Sequence[LostEntry]) -> tuple[LostEntry, ...]:
    """The intervals with the names of their first and last images, where frames counted from 0 are not these numbers:
    of a later block, of images numbered from elsewhere or with some missing, of names that are no numbers."""
    named = []
    for entry in entries:
        frames = (entry.first_frame, entry.last_frame)
        first, last = (plan.sequence.left[plan.share.first + frame].stem for frame in frames)
        numbers = numbers_of([first, last])
        same = numbers is not None and numbers.tolist() == list(frames)
        named.append(entry if same else replaced(entry, first_image=first, last_image=last))
    return tuple(named)


def _lost_entry(rows: NDArray[np.int64], kinds: NDArray[np.object_], whole: Gap | None) -> LostEntry:
    """Frames ``rows`` of one interval. What odometry says of the ``whole`` interval counts its frames: of a part of it
    the kinds are counted anew."""
    counts = Counter(kinds[rows].tolist())
    if whole is not None and len(rows) == whole.last_frame - whole.first_frame + 1:
        reason = whole.reason
    else:
        reason = kinds_text(counts)
    known = dict(counts.most_common()) if whole is None or whole.kinds else {}
    return LostEntry(first_frame=int(rows[0]), last_frame=int(rows[-1]), reason=reason, kinds=known)


def _within(share: SequenceShare, gaps: tuple[Gap, ...]) -> tuple[LostEntry, ...]:
    first, last = share.first, share.last
    return tuple(
        LostEntry(
            first_frame=max(gap.first_frame, first) - first,
            last_frame=min(gap.last_frame, last) - first,
            reason=gap.reason,
        )
        for gap in gaps
        if gap.first_frame <= last and gap.last_frame >= first
    )
