"""What is kept of every frame: small, and exactly what went in."""

from __future__ import annotations

import re
import tracemalloc
from collections import Counter

import numpy as np

from maslam.backend.geometry import se3_exp
from maslam.frontend.mapping.map import Map, MapKeyFrame
from maslam.frontend.mapping.memory_footprint import EMPTY, footprint
from maslam.frontend.reason import NO_REASON, Reason
from maslam.frontend.tracking.pose_log import LostInterval, MomentLog, PoseLog


def test_poses_come_back_bit_by_bit() -> None:
    poses = se3_exp(np.random.default_rng(0).normal(size=(5, 6)))
    log = PoseLog()
    for k, pose in enumerate(poses):
        log.note(10 + k, 100 * k, k // 2, pose)
    assert len(log) == 5 and log.keyframe(-2) == 1 and log.keyframe(0) == 0
    for k in (0, 3, 4, -1, -2):
        assert np.array_equal(log.T_C_K(k), poses[k])
    log.note(14, 400, 7, np.eye(4))  # the same frame, now on a key-frame of its own
    assert len(log) == 5 and log.keyframe(4) == 7 and np.array_equal(log.T_C_K(4), np.eye(4))
    assert np.array_equal(log.T_C_K(3), poses[3])
    np.testing.assert_array_equal(log.stamps_ns(), [0, 100, 200, 300, 400])


def test_lost_intervals_group_reasons_by_kind_and_tell_the_best_figure() -> None:
    log = MomentLog()
    assert log.latest_ns is None and log.lost([], hardly) == []
    low = [Reason("parallax too small", f"parallax {p:.2f} of 0.80 deg", p / 0.8) for p in (0.31, 0.79, 0.52)]
    dark = Reason("too few corners in the image", "only 3 corners", 0.1)
    for stamp, refusal in enumerate([dark, NO_REASON, NO_REASON, dark, *low, NO_REASON, NO_REASON]):
        log.note(stamp, refusal)
    posed = [np.array([1, 2]), np.array([7])]
    assert len(log) == 9 and log.latest_ns == 8
    # Three frames of one kind are one reason, with the best value reached; the other kind is counted.
    reason = "parallax 0.79 of 0.80 deg (nearest of 3 frames); too few corners in the image (1 frame)"
    corners, parallax = "too few corners in the image", "parallax too small"
    assert log.lost(posed, hardly) == [
        LostInterval(0, 0, 1, "only 3 corners", corners, ((corners, 1),)),
        LostInterval(3, 6, 4, reason, parallax, ((corners, 1), (parallax, 3))),
        LostInterval(8, 8, 1, "too short", "hardly moved", (("hardly moved", 1),)),
    ]
    assert log.lost([np.arange(9)], hardly) == []


def test_a_track_left_out_joins_the_refusals_around_it() -> None:
    log, static = MomentLog(), Reason("static", "moved by 1 px", 0.1)
    for stamp, refusal in enumerate([static, NO_REASON, NO_REASON, static, static]):
        log.note(stamp, refusal)
    reason = "moved by 1 px (nearest of 3 frames); hardly moved (2 frames)"
    runs = (("static", 1), ("hardly moved", 2), ("static", 2))
    assert log.lost([], hardly) == [LostInterval(0, 4, 5, reason, "static", runs)]


def test_each_frame_of_an_interval_has_one_reason() -> None:
    """Frames refused at random, some of which get a pose later, as a first view does: what is said of each interval is
    counted anew here, frame by frame."""
    rng, kinds = np.random.default_rng(4), ["", "", "dark", "static", "few"]
    for _ in range(50):
        of_frame = [kinds[k] for k in rng.integers(0, 5, 60)]
        reached = rng.uniform(0.1, 0.9, 60)
        log = MomentLog()
        for stamp, kind in enumerate(of_frame):
            log.note(stamp, Reason(kind, f"{kind} {stamp}", float(reached[stamp])) if kind else NO_REASON)
        posed = np.flatnonzero(rng.uniform(size=60) < 0.2)
        for one in log.lost([posed], hardly):
            inside = [of_frame[k] or "hardly moved" for k in range(one.first_ns, one.last_ns + 1)]
            assert [kind for kind, n in one.kinds for _ in range(n)] == inside
            first, *others = one.reason.split("; ")
            said = {text.partition(" (")[0]: int(text.partition(" (")[2].split()[0]) for text in others}
            main = re.search(r"(\d+) frames\)$", first)
            said[one.kind] = int(main[1]) if main else 1
            assert said == Counter(inside) and sum(said.values()) == one.frames == len(inside)
            # The figure is one of its own frames', where it has one.
            figure = re.match(rf"{one.kind} (\d+)", first)
            assert figure is None or one.first_ns <= int(figure[1]) <= one.last_ns


def test_a_first_view_parts_the_frames_before_a_start() -> None:
    """Five refused frames, of which the third is the first view of the track that starts after them."""
    log = MomentLog()
    for stamp, reached in enumerate([0.2, 0.4, 0.0, 0.6, 0.8]):
        log.note(stamp, Reason("static", f"moved by {stamp} px", reached))
    log.note(5, NO_REASON)
    before, after = log.lost([np.array([2, 5])], hardly)
    assert (before.frames, before.reason) == (2, "static (2 frames)")
    assert (after.frames, after.reason) == (2, "moved by 4 px (nearest of 2 frames)")


def hardly() -> Reason:
    return Reason("hardly moved", "too short")


def test_a_frame_costs_little_and_being_lost_for_long_nothing_more() -> None:
    pose, log, moments = np.eye(4), PoseLog(), MomentLog()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for k in range(20_000):
        log.note(k, k * 10**8, 1000, pose)
        text = f"only {k} points found, which is a long way of saying it, frame after frame"
        moments.note(k * 10**8, Reason("too few points", text, k / 20_000))
    spent = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert spent / 20_000 < 160


def test_the_footprint_counts_what_a_map_holds() -> None:
    map_ = Map()
    empty = footprint(map_)
    assert (empty.keyframes, empty.points, empty.observations) == (0, 0, 0)
    n = 500
    for number in range(3):
        ids = map_.add_points(n)
        zeros = np.zeros(n)
        map_.insert(
            MapKeyFrame(
                number=number,
                frame_index=number,
                stamp_ns=number,
                T_C_W=np.eye(4),
                uv=np.zeros((n, 2)),
                disparity=zeros,
                row=zeros,
                point=ids,
                sigma=zeros,
                level=np.zeros(n, dtype=np.int8),
                descriptors=np.zeros((n, 32), dtype=np.uint8),
                described=np.ones(n, dtype=bool),
                followed=np.ones(n, dtype=bool),
            )
        )
    assert map_.latest(2) == [1, 2] and map_.latest(9) == [0, 1, 2]
    full = footprint(map_)
    assert (full.keyframes, full.points, full.observations) == (3, 1500, 1500)
    row = 16 + 8 + 8 + 8 + 1 + 32 + 1 + 1  # bytes of one observation's row in the key-frame's arrays
    assert full.bytes - empty.bytes > 1500 * row
    map_.cull_keyframe(1, 0)
    assert footprint(map_).culled == 1 and footprint(map_).bytes < full.bytes - 500 * row
    assert (full + EMPTY) == full
