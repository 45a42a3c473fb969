"""Frames pushed one by one: the key-frames, poses and place vectors of preprocessing."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from maslam._replaced import replaced
from maslam.backend.geometry import se3_inverse
from maslam.descriptors.inference import NetVlad
from maslam.frontend.config import OdometryConfig
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.odometry import OdometryResult
from maslam.frontend.vocabulary.vocabulary import Vocabulary
from maslam.mas.live.observed import Observed, decode_observed, encode_observed
from maslam.tools.live.front_end import Beginning, LiveFrontEnd, TrackedLive
from maslam.tools.pipeline.tracking import Tracked, track

DEFAULT = OdometryConfig()
SMALL = replaced(DEFAULT, mapping=replaced(DEFAULT.mapping, window=6, fixed=2, min_found_ratio=0.4))
FRAMES = 17


@cache
def sequence_in(folder: Path) -> ImageSequence:
    return open_dataset(folder).sequences[0]


@cache
def preprocessed(folder: Path) -> Tracked:
    return track(sequence_in(folder), SMALL, Vocabulary.load(None), NetVlad.load(), lambda _: None)


@dataclass
class Driven:
    """A drive's frames with what was passed on by each, and at the end."""

    frames: list[TrackedLive] = field(default_factory=list)
    end: tuple[Observed, ...] = ()
    result: OdometryResult | None = None

    @property
    def observed(self) -> list[Observed]:
        return [*(one for frame in self.frames for one in frame.observed), *self.end]


@cache
def driven(folder: Path, after: int | None = None) -> Driven:
    sequence, out = sequence_in(folder), Driven()
    front_end = LiveFrontEnd(sequence.rig, SMALL, Vocabulary.load(None), NetVlad.load(), sequence.name, after)
    for index in range(len(sequence)):
        out.frames.append(front_end.process(sequence.read(index)))
    out.end, out.result = front_end.finish()
    return out


def test_the_key_frames_are_those_of_preprocessing_bit_for_bit(town_stereo: Path) -> None:
    whole, live = preprocessed(town_stereo), driven(town_stereo)
    keyframes, (poses,) = [one.keyframe for one in live.observed], [track.poses for track in whole.tracks]
    assert [k.index for k in keyframes] == list(range(len(keyframes)))
    stamps = sequence_in(town_stereo).stamps_ns
    np.testing.assert_array_equal([k.stamp_ns for k in keyframes], stamps[whole.keyframes[0]])
    np.testing.assert_array_equal([k.time_ns for k in keyframes], stamps[whole.keyframes[0]] - stamps[0])
    np.testing.assert_array_equal(np.stack([k.T_T_C for k in keyframes]), poses)
    np.testing.assert_array_equal(np.stack([k.vector for k in keyframes]), whole.vectors)
    np.testing.assert_array_equal([k.textured for k in keyframes], whole.textured)
    assert len(live.end) < len(keyframes) - 2, "some were passed on while the camera went on"


def test_what_is_left_at_the_end_is_what_preprocessing_has(town_stereo: Path) -> None:
    whole, result = preprocessed(town_stereo), driven(town_stereo).result
    assert result is not None
    for mine, theirs in zip(result.tracks, whole.tracks, strict=True):
        for name in ("stamps_s", "poses", "points", "observations", "descriptors", "words"):
            np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))


def test_every_frame_has_its_pose(town_stereo: Path) -> None:
    """To the rounding of a pose that hangs on a key-frame which goes later."""
    (frames,) = preprocessed(town_stereo).trajectories
    observed = driven(town_stereo).observed
    start_ns = sequence_in(town_stereo).stamps_ns[0]
    np.testing.assert_array_equal(np.concatenate([o.frames.stamps_ns for o in observed]), frames.stamps_ns - start_ns)
    np.testing.assert_allclose(np.concatenate([o.frames.poses for o in observed]), frames.poses, rtol=0, atol=1e-12)


def test_the_points_are_those_of_preprocessing_but_for_what_later_views_change(town_stereo: Path) -> None:
    """Descriptors tell which observation is which. Passed on early, a key-frame has nearly all of them, and some that
    later views find wrong; those passed on at the end are preprocessing's."""
    (whole,), live = preprocessed(town_stereo).tracks, driven(town_stereo)
    seen: set[int] = set()
    for k, one in enumerate(live.observed):
        keyframe = one.keyframe
        rows = np.flatnonzero(whole.observations[:, 0] == k)
        theirs = {whole.descriptors[r].tobytes(): whole.points[whole.observations[r, 1]] for r in rows}
        mine = {d.tobytes(): p for d, p in zip(keyframe.descriptors, keyframe.points_C, strict=True)}
        both = sorted(theirs.keys() & mine.keys())
        assert len(both) >= 0.98 * len(theirs) and len(mine) <= 1.25 * len(theirs)
        T_C_T = se3_inverse(whole.poses[k])
        expected = np.stack([T_C_T[:3, :3] @ theirs[d] + T_C_T[:3, 3] for d in both])
        off = np.linalg.norm(np.stack([mine[d] for d in both]) - expected, axis=1) / expected[:, 2]
        assert np.median(off) < 5e-3 and np.mean(off < 0.05) > 0.95
        if one in live.end:
            assert theirs.keys() == mine.keys() and off.max() < 1e-6
            assert keyframe.depth == pytest.approx(np.median(expected[:, 2]), rel=1e-6)
        ids = keyframe.point_ids.tolist()
        assert len(set(ids)) == len(ids)
        assert keyframe.first_seen.tolist() == [point not in seen for point in ids]
        seen.update(ids)
    assert seen == set(range(len(seen)))


def test_each_frame_is_placed_by_the_latest_key_frame_passed_on(town_stereo: Path) -> None:
    """A pose at once: that of the finished track but for what the window still refines."""
    live, (frames,) = driven(town_stereo), preprocessed(town_stereo).trajectories
    known = [(k, one) for k, one in enumerate(live.frames) if one.keyframe is not None]
    assert len(known) >= 8 and all(one.keyframe is None for one in live.frames[:3])
    for k, one in known:
        assert one.keyframe is not None and one.T_K_C is not None
        T_T_C = live.observed[one.keyframe].keyframe.T_T_C @ one.T_K_C
        assert np.linalg.norm(T_T_C[:3, 3] - frames.poses[k][:3, 3]) < 0.02


def test_key_frames_may_be_passed_on_sooner(town_stereo: Path) -> None:
    """By one newer key-frame: sooner, and each step from one to the next is the map's at that time."""
    sequence, final = sequence_in(town_stereo), driven(town_stereo)
    front_end = LiveFrontEnd(sequence.rig, SMALL, Vocabulary.load(None), NetVlad.load(), sequence.name, 1)
    given: list[Observed] = []
    for index in range(len(sequence)):
        for one in front_end.process(sequence.read(index)).observed:
            keyframes = front_end.odometry.maps[-1].keyframes.values()
            now = {k.stamp_ns: k.T_W_C for k in keyframes}
            if given:
                before, this = given[-1].keyframe, one.keyframe
                step = se3_inverse(before.T_T_C) @ this.T_T_C
                expected = se3_inverse(now[before.stamp_ns]) @ now[this.stamp_ns]
                np.testing.assert_allclose(step, expected, rtol=0, atol=1e-12)
            given.append(one)
    end, _ = front_end.finish()
    assert len(end) < len(final.end)
    given += end
    assert [o.keyframe.stamp_ns for o in given] == [o.keyframe.stamp_ns for o in final.observed]
    assert not np.array_equal(given[-1].keyframe.T_T_C, final.observed[-1].keyframe.T_T_C)
    with pytest.raises(ValueError, match="waits for 1 newer one"):
        driven(town_stereo, after=0)


def test_frames_after_the_last_key_frame_are_passed_on(town_stereo: Path) -> None:
    """Also where the latest key-frames are such as only support the window."""
    sequence = sequence_in(town_stereo)
    front_end = LiveFrontEnd(sequence.rig, SMALL, Vocabulary.load(None), NetVlad.load(), sequence.name, 1)
    observed: list[Observed] = []
    for index in range(FRAMES):
        observed += front_end.process(sequence.read(index)).observed
    (latest,) = (list(map_.keyframes.values())[-1] for map_ in front_end.odometry.maps)
    assert not latest.stays
    observed += front_end.finish()[0]
    stamps = np.concatenate([one.frames.stamps_ns for one in observed])
    np.testing.assert_array_equal(stamps, sequence.stamps_ns[:FRAMES] - sequence.stamps_ns[0])


def test_a_key_frame_survives_the_journals_bytes(town_stereo: Path) -> None:
    for one in driven(town_stereo).observed:
        again = decode_observed(encode_observed(one))
        for name in vars(one.keyframe):
            np.testing.assert_array_equal(getattr(again.keyframe, name), getattr(one.keyframe, name))
        np.testing.assert_array_equal(again.frames.stamps_ns, one.frames.stamps_ns)
        np.testing.assert_array_equal(again.frames.poses, one.frames.poses)


def test_a_front_end_goes_on_after_earlier_key_frames(town_stereo: Path) -> None:
    """As a new track: numbers, points and times go on."""
    earlier = [one.keyframe for one in driven(town_stereo).observed[:4]]
    beginning = Beginning.after(earlier)
    sequence = sequence_in(town_stereo)
    later = LiveFrontEnd(sequence.rig, SMALL, Vocabulary.load(None), NetVlad.load(), sequence.name, beginning=beginning)
    frames = [later.process(sequence.read(index)) for index in range(10, len(sequence))]
    first = [*(one for frame in frames for one in frame.observed), *later.finish()[0]][0].keyframe
    assert (first.index, first.track, first.stamp_ns) == (4, 1, sequence.stamps_ns[10])
    assert first.time_ns == sequence.stamps_ns[10] - sequence.stamps_ns[0]
    assert first.point_ids.min() == max(k.point_ids.max() for k in earlier) + 1
