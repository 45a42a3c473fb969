"""Made-up worlds with a known truth: points with random ORB descriptors, agents that drive past them, odometry that
drifts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, se3, se3_exp, se3_inverse, so3_exp, transform_points
from maslam.descriptors.container import PlaceVectors
from maslam.frontend.files.trajectory import Trajectory
from maslam.frontend.files.vo_files import VoTrack
from maslam.mas.config import MasConfig
from maslam.mas.manifest import AgentEntry, CameraEntry, DescriptorEntry, Manifest
from maslam.mas.policies.presets import preset
from maslam.mas.sequence import AgentSequence

MODEL = "made-up"
SHA256 = "ab" * 32
DIM = 32
THRESHOLD = 0.35
CAMERA = CameraEntry(kind="stereo", width=640, height=360, fx=320, fy=320, cx=319.5, cy=179.5, baseline_m=0.5)
ONE_CAMERA = CAMERA.model_copy(update={"kind": "mono", "baseline_m": None})
FRAMES_A_KEYFRAME = 3
FRAME_NS = 100_000_000


@dataclass(frozen=True, eq=False)
class World:
    """``points`` ``(P, 3)`` W, +Y down; ``descriptors`` ``(P, 32)``; ``words`` ``(P,)``; ``waves`` of the place
    vectors."""

    points: Array
    descriptors: NDArray[np.uint8]
    words: NDArray[np.int32]
    waves: Array
    period_m: float | None


def make_world(seed: int, size_m: float = 120.0, points: int = 60_000, period_m: float | None = None) -> World:
    """Points everywhere. With ``period_m``, place vectors and descriptors repeat along X: every place has
    look-alikes, whose points stand elsewhere relative to the camera, or, in the worst case, in the same way."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform([-size_m, -4.0, -size_m], [size_m, 1.5, size_m], (points, 3))
    descriptors = rng.integers(0, 256, (points, 32), dtype=np.uint8)
    words = rng.integers(0, 10_000, points).astype(np.int32)
    return World(xyz, descriptors, words, rng.normal(size=(DIM, 4)), period_m)


def place_vector(world: World, T_W_C: Array) -> NDArray[np.float32]:
    """A unit vector that changes smoothly with position (about 8 m) and heading: near poses give near vectors."""
    x, z = T_W_C[0, 3], T_W_C[2, 3]
    if world.period_m:
        x = x % world.period_m
    forward = T_W_C[:3, 2]
    v = np.cos(world.waves @ np.array([x / 8.0, z / 8.0, 2.0 * forward[0], 2.0 * forward[2]]) + np.arange(DIM))
    return (v / np.linalg.norm(v)).astype(np.float32)


def heading(x: float, z: float, yaw: float) -> Array:
    """Camera pose at ``(x, 0, z)`` looking along ``(sin yaw, 0, cos yaw)``."""
    return se3(so3_exp([0.0, yaw, 0.0]), [x, 0.0, z])


def circuit(start_m: float, length_m: float, step_m: float = 0.5, side_m: float = 50.0, radius_m: float = 8.0) -> Array:
    """Poses ``(N, 4, 4)`` along a square street of four sides with round corners, clockwise."""
    straight, arc = side_m - 2 * radius_m, np.pi / 2 * radius_m
    poses = []
    for s in np.arange(start_m, start_m + length_m, step_m):
        leg, along = divmod(s, straight + arc)
        corner = leg % 4 * np.pi / 2
        if along <= straight:
            local = (0.0, radius_m + along, 0.0)
        else:
            turn = (along - straight) / radius_m
            local = (radius_m * (1 - np.cos(turn)), side_m - radius_m + radius_m * np.sin(turn), turn)
        base = se3_inverse(heading(side_m / 2, side_m / 2, 0.0))
        T_W_L = so3_exp([0.0, corner, 0.0])
        centre = T_W_L @ (base[:3, 3] + np.array([local[0], 0.0, local[1]]))
        poses.append(heading(centre[0], centre[2], corner + local[2]))
    return np.array(poses)


def drift(truth: Array, rng: np.random.Generator, share: float = 0.01, yaw_deg: float = 0.06) -> Array:
    """Odometry of a true path: each step wrong by ``share`` of its length, with a lasting bias, and by some
    rotation."""
    bias = rng.normal(0.0, [share / 2] * 3 + [np.radians(yaw_deg) / 4] * 3)
    poses = [np.eye(4)]
    for a, b in pairwise(truth):
        step = se3_inverse(a) @ b
        length = float(np.linalg.norm(step[:3, 3]))
        noise = rng.normal(0.0, [share / 2 * length] * 3 + [np.radians(yaw_deg) / 2] * 3)
        poses.append(poses[-1] @ step @ se3_exp(noise + bias * [length, length, length, 1.0, 1.0, 1.0]))
    return np.array(poses)


def travelled_by(truth: Array) -> Array:
    """``(N,)``: metres travelled by each of true poses ``(N, 4, 4)``."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1))])


def rescaled(odometry: Array, scales: Array) -> Array:
    """The track with each step times the scale ``(N,)`` at its first pose: one camera's, whose unit drifts."""
    out = odometry.copy()
    steps = np.diff(odometry[:, :3, 3], axis=0) * scales[:-1, None]
    out[:, :3, 3] = odometry[0, :3, 3] + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return out


def make_sequence(
    world: World,
    truth: Array,
    seed: int,
    number: int = 0,
    scale: float = 1.0,
    cuts: Sequence[int] = (),
    max_points: int = 250,
    noise_m: float = 0.02,
    with_truth: bool = True,
    drifting: float = 0.01,
    unit_drift: float = 0.0,
    drifts: Callable[[Array, np.random.Generator], Array] | None = None,
) -> AgentSequence:
    """The sequence of an agent along true poses (one a frame); every third frame is a key-frame.

    ``drifting`` 0: exact odometry. ``scale`` other than 1: monocular, metres in one own unit are 1/scale (each later
    track's 1.5 times that of the one before); the scale's logarithm grows by ``unit_drift`` a metre. ``cuts``: frames
    at which tracking was lost and a new track began. ``drifts``: odometry of a true path, instead of ``drifting``.
    """
    rng = np.random.default_rng([seed, number])
    bounds = [0, *cuts, len(truth)]
    tracks, frames, stamps = [], [], []
    vectors = []
    for number_of_track, (first, last) in enumerate(pairwise(bounds)):
        way = truth[first:last]
        odometry = drifts(way, rng) if drifts else drift(way, rng, drifting, 0.06 if drifting else 0.0)
        start = scale if scale == 1.0 else scale * 1.5**number_of_track
        scales = start * np.exp(unit_drift * travelled_by(truth[first:last]))
        odometry = rescaled(odometry, scales)
        keys = np.arange(0, last - first, FRAMES_A_KEYFRAME)
        seen = truth[first:last][keys]
        times_s = (first + keys) * 0.1
        tracks.append(_track(world, seen, odometry[keys], times_s, rng, scales[keys], max_points, noise_m))
        vectors += [place_vector(world, T) for T in seen]
        frames.append(odometry)
        stamps.append(np.arange(first, last, dtype=np.int64) * FRAME_NS)
    all_stamps = np.concatenate(stamps)
    key_stamps = np.rint(np.concatenate([t.stamps_s for t in tracks]) * 1e9).astype(np.int64)
    unit = np.array(vectors, dtype=np.float32)
    places = PlaceVectors(MODEL, SHA256, DIM, key_stamps, unit, np.ones(len(unit), dtype=bool))
    return AgentSequence(
        name=f"agent_{number:02d}",
        tracks=tuple(tracks),
        places=places,
        trajectory=Trajectory(all_stamps, np.concatenate(frames)),
        metric=scale == 1.0,
        start_ns=1_000_000_000 * number,
        source=f"agent_{number:02d}",
        groundtruth=Trajectory(all_stamps, truth) if with_truth else None,
    )


def _track(
    world: World,
    truth: Array,
    odometry: Array,
    stamps_s: Array,
    rng: np.random.Generator,
    scales: Array,
    limit: int,
    noise_m: float,
) -> VoTrack:
    seen = [visible(world, T_W_C, limit, rng) for T_W_C in truth]
    flat = np.concatenate(seen)
    keyframe = np.repeat(np.arange(len(seen)), [len(rows) for rows in seen])
    first_seen, inverse = map_points(flat, keyframe)
    points = np.zeros((len(first_seen), 3))
    for k, (T_W_C, T_T_C) in enumerate(zip(truth, odometry, strict=True)):
        mine = np.flatnonzero(keyframe[first_seen] == k)
        p_C = transform_points(se3_inverse(T_W_C), world.points[flat[first_seen[mine]]])
        p_C = (p_C + rng.normal(0.0, noise_m, p_C.shape) * p_C[:, 2:] / 10.0) * scales[k]
        points[mine] = transform_points(T_T_C, p_C)
    words = world.words[flat]
    return VoTrack(
        stamps_s=np.asarray(stamps_s, dtype=np.float64),
        poses=odometry,
        points=points,
        observations=np.column_stack([keyframe, inverse]).astype(np.int32),
        descriptors=flipped(world.descriptors[flat], rng),
        words=np.column_stack([words // 10, words]).astype(np.int32),
    )


def map_points(seen: NDArray[np.intp], keyframe: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The map point of each observation, and each map point's first observation. Odometry closes no loops: a point
    that comes back after a while becomes a new map point.
    """
    order = np.lexsort((keyframe, seen))
    fresh = np.ones(len(order), dtype=bool)
    fresh[1:] = (np.diff(seen[order]) != 0) | (np.diff(keyframe[order]) > 5)
    point = np.empty(len(order), dtype=np.intp)
    point[order] = np.cumsum(fresh) - 1
    return order[fresh], point


def visible(world: World, T_W_C: Array, limit: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Points that the camera sees within 25 m; the nearest ``limit``, most of them."""
    near = np.flatnonzero(np.abs(world.points[:, [0, 2]] - T_W_C[[0, 2], 3]).max(axis=1) < 25.0)
    p = transform_points(se3_inverse(T_W_C), world.points[near])
    inside = (p[:, 2] > 1.0) & (np.abs(p[:, 0]) < p[:, 2]) & (np.abs(p[:, 1]) < 0.56 * p[:, 2]) & (p[:, 2] < 25.0)
    rows, depth = near[inside], p[inside, 2]
    chosen = rows[np.argsort(depth, kind="stable")][:limit]
    return np.sort(chosen[rng.random(len(chosen)) < 0.8])


def flipped(descriptors: NDArray[np.uint8], rng: np.random.Generator, bits: int = 12) -> NDArray[np.uint8]:
    """Descriptors ``(n, 32)`` with some bits turned, as another view of the points would have them."""
    out = np.unpackbits(descriptors, axis=1)
    np.put_along_axis(out, at := rng.integers(0, 256, (len(out), bits)), 1 - np.take_along_axis(out, at, 1), 1)
    return np.packbits(out, axis=1)


def talkative(**places: object) -> MasConfig:
    """Our preset, but everyone asks everyone about each key-frame and optimises often: more contracts in the same
    time."""
    config = preset("maslam")
    asks = {"code": "int8", "certainty": "candidate", "gap_keyframes": 4, "first_points": 200, **places}
    return config.model_copy(
        update={
            "policy": "query_all",
            "ask_again": False,
            "places": config.places.model_copy(update=asks),
            "optimisation": config.optimisation.model_copy(update={"period_keyframes": 5}),
        }
    )


def manifest_of(sequences: Sequence[AgentSequence], sha256: str = SHA256) -> Manifest:
    """The manifest that preprocessing would have written for them."""
    return Manifest(
        source="made up",
        kind="synthetic",
        scale="metric" if any(s.metric for s in sequences) else "arbitrary",
        descriptor=DescriptorEntry(name=MODEL, sha256=sha256, dim=DIM, threshold=THRESHOLD, min_std=0.0),
        agents=tuple(
            AgentEntry(
                name=s.name,
                sequence=s.source,
                first_frame=s.first_frame,
                frames=s.read,
                keyframes=len(s.places.vectors),
                tracks=len(s.tracks),
                start_ns=s.start_ns,
                camera=CAMERA if s.metric else ONE_CAMERA,
                lost=s.lost,
                doubtful=s.doubtful,
            )
            for s in sequences
        ),
    )


def town(
    agents: int = 4, keyframes: int = 40, seed: int = 0, spacing_m: float | None = None, **options: Any
) -> tuple[Manifest, list[AgentSequence]]:
    """Agents on one circuit (186 m round), starting ``spacing_m`` apart (else all around it), driving over each other's
    ground.
    """
    world = make_world(seed)
    way = keyframes * FRAMES_A_KEYFRAME * 0.5
    apart = (4 * (50.0 - 16.0) + 2 * np.pi * 8.0) / agents if spacing_m is None else spacing_m
    sequences = [make_sequence(world, circuit(a * apart, way), seed, a, **options) for a in range(agents)]
    return manifest_of(sequences), sequences
