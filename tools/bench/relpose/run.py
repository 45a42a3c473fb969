"""``maslam bench relpose``: is a place match accepted when it is right, and refused when it only looks right?"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from maslam.backend.config import RelPoseConfig
from maslam.backend.geometry import Array, rotation_angle_deg, se3_inverse, se3_log
from maslam.backend.relpose.point_coding import PointCode, as_sent
from maslam.backend.relpose.verification import PlaceView, Verdict, relative_pose

from ...common.errors import UsageError
from ...common.progress import Progress
from ...common.text_table import aligned
from .pairs import KeyPoints, Pair, key_points, look_alike_pairs, right_pairs
from .places import RelPosePlacesConfig, rendered_visits

SHARED_BINS = (0.2, 0.3, 0.4, 0.5, 0.7, 1.01)
ANGLE_BINS_DEG = (0.0, 10.0, 25.0, 40.0)
MIN_SHARED, MAX_ANGLE_DEG = 0.3, 25.0
"""What a match must share to be expected."""
_FAR_OFF_M, _FAR_OFF_DEG = 0.5, 3.0


@dataclass(frozen=True)
class RelPoseSettings:
    """``worlds``: kind and seed; ``right``: places of each; ``look_alikes``: wrong pairs in all, the same number from
    each world; ``points``: sent by the query, at most (0: all); ``code``: how; ``features``: compared."""

    worlds: tuple[tuple[Literal["town", "indoor"], int], ...]
    right: int
    look_alikes: int
    relpose: RelPoseConfig
    points: int = 0
    code: PointCode = "float"
    features: Literal["descriptors", "words"] = "descriptors"
    descriptor_bytes: int = 32
    size: tuple[int, int] = (480, 360)
    cache: Path | None = None
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Judged:
    """A pair and what became of it; errors are NaN without a pose. ``squared``: error in its own standard deviations,
    squared, over the 6 degrees of freedom."""

    world: str
    pair: Pair
    verdict: Verdict
    error_m: float
    error_deg: float
    squared: float
    sent_bytes: int
    ms: float


@dataclass(frozen=True)
class RelPoseReport:
    """Shares and figures. ``expected``: right pairs that share :data:`MIN_SHARED` within :data:`MAX_ANGLE_DEG`;
    ``far_off``: accepted of these with a wrong pose; errors of accepted ones."""

    worlds: list[str]
    expected: int
    accepted_share: float
    far_off: int
    look_alikes: int
    false_accepted: list[str]
    median_m: float
    ninety_m: float
    median_deg: float
    ninety_deg: float
    squared_per_dof: float
    bytes_each: float
    ms: float
    by_world: dict[str, float]
    by_view: dict[str, tuple[int, int]]
    refused_right: dict[str, int]
    refused_wrong: dict[str, int]

    def json(self) -> str:
        """All figures as JSON text."""
        return json.dumps(asdict(self), indent=1)

    def text(self) -> str:
        """For people."""
        rows = [["shared view", *(f"{a:.0f} to {b:.0f} deg" for a, b in _steps(ANGLE_BINS_DEG))]]
        for low, high in _steps(SHARED_BINS):
            cells = [self.by_view.get(_bin(low, a), (0, 0)) for a, _ in _steps(ANGLE_BINS_DEG)]
            rows.append([f"{low:.0%} to {min(high, 1.0):.0%}", *(f"{k} of {n}" if n else "-" for k, n in cells)])
        figures = [
            ["worlds", ", ".join(self.worlds)],
            ["accepted", f"{self.accepted_share:.1%} of {self.expected} that share 30 % within 25 degrees"],
            ["", ", ".join(f"{name} {share:.0%}" for name, share in self.by_world.items())],
            ["falsely accepted", f"{len(self.false_accepted)} of {self.look_alikes} look-alike pairs"],
            ["far off", f"{self.far_off} of the accepted by more than {_FAR_OFF_M} m or {_FAR_OFF_DEG} degrees"],
            ["error, median", f"{100 * self.median_m:.1f} cm, {self.median_deg:.2f} degrees"],
            ["error, 90 %", f"{100 * self.ninety_m:.1f} cm, {self.ninety_deg:.2f} degrees"],
            [
                "squared error",
                f"{self.squared_per_dof:.2f} of what the information states, median (0.89 if consistent)",
            ],
            ["bytes", f"{self.bytes_each:.0f} of points and descriptors a verification"],
            ["time", f"{self.ms:.1f} ms of one core a verification"],
            ["right, refused", _counted(self.refused_right)],
            ["look-alike, refused", _counted(self.refused_wrong)],
        ]
        width = max(len(name) for name, _ in figures)
        lines = [f"{name.ljust(width)}  {value}" for name, value in figures]
        return "\n".join([*lines, "", *aligned(rows), *(f"false: {name}" for name in self.false_accepted)])


def bench_relpose(settings: RelPoseSettings, progress: Progress) -> RelPoseReport:
    """Render or load, match every pair, and count."""
    judged: list[Judged] = []
    for kind, seed in settings.worlds:
        judged += _judge_world(kind, seed, settings, progress)
    return summarise(judged)


def _judge_world(
    kind: Literal["town", "indoor"], seed: int, settings: RelPoseSettings, progress: Progress
) -> Iterator[Judged]:
    from maslam.descriptors.inference import NetVlad
    from maslam.frontend.vocabulary.vocabulary import Vocabulary

    twins = settings.right // 2 if kind == "indoor" else 0
    w, h = settings.size
    config = RelPosePlacesConfig(width=w, height=h, places=settings.right, twins=twins)
    task, done = progress.start(f"{kind} {seed}: rendering", settings.right), 0

    def tick() -> None:
        nonlocal done
        done += 1
        progress.advance(task, done)

    visits = rendered_visits(kind, seed, config, settings.cache, tick)
    progress.advance(task, settings.right)
    vocabulary = Vocabulary.load()
    views = [key_points(visit, vocabulary.words) for visit in visits]
    wanted = settings.look_alikes // len(settings.worlds)
    vectors = NetVlad.load().describe([visit.left for visit in visits])
    pairs = [*right_pairs(visits), *look_alike_pairs(visits, vectors, wanted)]
    whole = [_view(v, settings) for v in views]
    sent = [as_sent(v, settings.points, settings.code, settings.descriptor_bytes) for v in whole]
    task = progress.start(f"{kind} {seed}: verifying", len(pairs))
    for k, pair in enumerate(pairs, 1):
        rng = np.random.default_rng([settings.seed, pair.query, pair.match])
        query, size = sent[pair.query]
        began = time.process_time()
        verdict = relative_pose(query, whole[pair.match], settings.relpose, rng)
        ms = 1e3 * (time.process_time() - began)
        yield _judged(f"{kind}_{seed}", pair, verdict, size, ms)
        progress.advance(task, k)


def _view(points: KeyPoints, settings: RelPoseSettings) -> PlaceView:
    known = np.isfinite(points.points_C[:, 0])
    by_words = settings.features == "words"
    return PlaceView(
        points.points_C[known],
        descriptors=None if by_words else points.descriptors[known],
        words=points.words[known] if by_words else None,
    )


def _judged(world: str, pair: Pair, verdict: Verdict, sent_bytes: int, ms: float) -> Judged:
    nan = float("nan")
    if verdict.T_M_Q is None or verdict.information is None:
        return Judged(world, pair, verdict, nan, nan, nan, sent_bytes, ms)
    found = verdict.T_M_Q.se3()
    off: Array = se3_log(se3_inverse(found) @ pair.T_M_Q)
    return Judged(
        world,
        pair,
        verdict,
        error_m=float(np.linalg.norm(found[:3, 3] - pair.T_M_Q[:3, 3])),
        error_deg=float(rotation_angle_deg(found[:3, :3].T @ pair.T_M_Q[:3, :3])),
        squared=float(off @ verdict.information @ off) / 6.0,
        sent_bytes=sent_bytes,
        ms=ms,
    )


def summarise(judged: list[Judged]) -> RelPoseReport:
    """The report on all pairs of all worlds."""
    worlds = sorted({j.world for j in judged})
    wrong = [j for j in judged if not j.pair.right]
    expected = [j for j in judged if j.pair.right and j.pair.shared >= MIN_SHARED and j.pair.angle_deg <= MAX_ANGLE_DEG]
    good = [j for j in expected if j.verdict.accepted]
    metres, degrees = (np.array([getattr(j, name) for j in good]) for name in ("error_m", "error_deg"))
    views: dict[str, tuple[int, int]] = {}
    for j in judged:
        if j.pair.right:
            name = _bin(_floor(j.pair.shared, SHARED_BINS), _floor(j.pair.angle_deg, ANGLE_BINS_DEG))
            k, n = views.get(name, (0, 0))
            views[name] = (k + j.verdict.accepted, n + 1)
    return RelPoseReport(
        worlds=worlds,
        expected=len(expected),
        accepted_share=len(good) / max(len(expected), 1),
        far_off=int(((metres > _FAR_OFF_M) | (degrees > _FAR_OFF_DEG)).sum()),
        look_alikes=len(wrong),
        false_accepted=[f"{j.world}: {j.pair.query} - {j.pair.match}" for j in wrong if j.verdict.accepted],
        median_m=_quantile(metres, 0.5),
        ninety_m=_quantile(metres, 0.9),
        median_deg=_quantile(degrees, 0.5),
        ninety_deg=_quantile(degrees, 0.9),
        squared_per_dof=_quantile(np.array([j.squared for j in good]), 0.5),
        bytes_each=float(np.mean([j.sent_bytes for j in judged])),
        ms=float(np.median([j.ms for j in judged])),
        by_world={
            w: float(np.mean([j.verdict.accepted for j in expected if j.world == w]))
            for w in worlds
            if any(j.world == w for j in expected)
        },
        by_view=views,
        refused_right=_kinds(expected),
        refused_wrong=_kinds(wrong),
    )


def worlds_named(names: str) -> tuple[tuple[Literal["town", "indoor"], int], ...]:
    """``town_51,indoor_52`` as kinds and seeds."""
    out: list[tuple[Literal["town", "indoor"], int]] = []
    for name in names.split(","):
        kind, _, seed = name.strip().partition("_")
        if kind not in ("town", "indoor") or not seed.isdigit():
            raise UsageError(f"--worlds: {name.strip()!r} is not town_SEED or indoor_SEED")
        out.append(("town" if kind == "town" else "indoor", int(seed)))
    return tuple(out)


def _kinds(judged: list[Judged]) -> dict[str, int]:
    kinds = [j.verdict.kind for j in judged if not j.verdict.accepted]
    return {kind: kinds.count(kind) for kind in sorted(set(kinds), key=lambda k: (-kinds.count(k), k))}


def _counted(kinds: dict[str, int]) -> str:
    return ", ".join(f"{kind} {n}" for kind, n in kinds.items()) or "none"


def _quantile(values: Array, share: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share)) if len(known) else float("nan")


def _steps(bounds: tuple[float, ...]) -> list[tuple[float, float]]:
    return list(pairwise(bounds))


def _floor(value: float, bounds: tuple[float, ...]) -> float:
    return max([b for b in bounds[:-1] if b <= value], default=bounds[0])


def _bin(shared: float, angle_deg: float) -> str:
    return f"{shared:.0%} {angle_deg:.0f} deg"
