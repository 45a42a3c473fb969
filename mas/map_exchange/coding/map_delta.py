"""Change from one version of a map to the next, in few bits: new key-frames with their points, corrections of old
poses, new matches. Against nothing it is the whole map. All arithmetic is on whole numbers: every copy gets the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...protocol.ids import MAX_AGENTS, MAX_POINTS, FrameId
from ...protocol.tensors import MAX_SCALE
from .pose_corrections import Bound, anchors_for, interpolated
from .quantised_map import RIGID, WITH_UNIT, Ints, QuantisedMap, Steps, StepsError, empty_map, size, widened
from .rice import BitReader, BitWriter, CodingError

MAX_KEYFRAMES = 1_000_000
# Contexts: numbers that are of one size share one.
_HEAD, _INDEX, _TICK, _COUNT, _GAP, _FIRST, _DEPTH, _MATCH = 0, 1, 2, 3, 4, 5, 6, 7
_POSE = np.array([8, 9, 10, 11, 12, 13, 27])
_MOVE = np.array([14, 15, 16, 17, 18, 19, 28])
_TRANSFORM = np.arange(20, 27)
KEPT, ANCHORS, ANEW = 0, 1, 2
_LOW = 2**31
_LARGEST = 2**52


def is_prefix(base: QuantisedMap, target: QuantisedMap) -> bool:
    """Whether the target has all key-frames of the base, first and in the same order: else only the whole map helps."""
    k = len(base.keyframes)
    return base.steps == target.steps and np.array_equal(base.keyframes, target.keyframes[:k])


def encode(base: QuantisedMap | None, wanted: QuantisedMap, bound: Bound) -> tuple[bytes, QuantisedMap]:
    """The bits that make a version of a base (of nothing: the whole map), and the version that they make: ``wanted``
    but for the poses of old key-frames, which are within ``bound``. It is drifting where the base is."""
    base = None if base is None else replace(base, poses=widened(base.poses, wanted.poses.shape[1]))
    old = 0 if base is None else len(base.keyframes)
    options = [(ANEW, wanted.poses, np.zeros(0, dtype=np.intp))]
    if base is not None and old:
        moves = wanted.poses[:old] - base.poses
        if bound.worst(moves).max() <= 1.0:
            options = [(KEPT, _with_old(wanted.poses, base.poses), options[0][2])]
        else:
            anchors = anchors_for(moves, bound)
            moved = base.poses + interpolated(moves[anchors], anchors, old)
            options.append((ANCHORS, _with_old(wanted.poses, moved), anchors))
    best: tuple[bytes, QuantisedMap] | None = None
    for mode, poses, anchors in options:
        made = replace(wanted, poses=poses)
        data = _write(base, made, mode, anchors)
        if best is None or len(data) < len(best[0]):
            best = data, made
    assert best is not None
    return best


def _with_old(poses: Ints, old: Ints) -> Ints:
    return np.concatenate([old, poses[len(old) :]])


def _write(base: QuantisedMap | None, made: QuantisedMap, mode: int, anchors: NDArray[np.intp]) -> bytes:
    out, old = BitWriter(), 0 if base is None else len(base.keyframes)
    if base is None:
        s = made.steps
        out.put_signed([s.position, s.rotation, s.direction, s.depth], _HEAD)
    out.put([len(made.keyframes) - old, mode], _HEAD)
    if mode == ANCHORS:
        assert base is not None
        moves = (made.poses[:old] - base.poses)[anchors]
        out.put([len(anchors) - 2 if old > 1 else 0], _HEAD)
        out.put(np.diff(anchors)[:-1] - 1, _HEAD)
        out.put_signed(np.diff(moves, axis=0, prepend=0), _MOVE[: moves.shape[1]])
    before = 0 if not old else int(made.keyframes[old - 1]) + 1
    out.put(np.diff(made.keyframes[old:], prepend=before - 1) - 1, _INDEX)
    _write_ticks(out, made.ticks, old)
    start = 0 if mode == ANEW else old
    rest = made.poses[start:]
    out.put_signed(rest - _expected(made.poses, start), _POSE[: rest.shape[1]])
    _write_points(out, made, old, int(made.counts[:old].sum()))
    _write_matches(out, base, made)
    return out.data


def _write_ticks(out: BitWriter, ticks: Ints, old: int) -> None:
    new = ticks[old:]
    if not old and len(new):
        out.put_signed([new[0] // _LOW], _FIRST)
        out.put([new[0] % _LOW], _FIRST)
        new = np.diff(new)
    elif old:
        new = np.diff(new, prepend=ticks[old - 1])
    out.put_signed(new, _TICK)


def _expected(poses: Ints, start: int) -> Ints:
    """Prediction of each pose from ``start`` on from the two before it: the same step again."""
    padded = np.concatenate([np.repeat(poses[:1] * 0, 2, axis=0), poses])
    one, two = padded[start + 1 : len(poses) + 1], padded[start : len(poses)]
    expected: Ints = 2 * one - two
    if start < 2 and len(expected):
        expected[: 2 - start] = one[: 2 - start]
    return expected


def _write_points(out: BitWriter, made: QuantisedMap, old: int, first: int) -> None:
    counts, cells = made.counts[old:], made.cells[first:]
    out.put(counts, _COUNT)
    if not len(cells):
        return
    low, high = cells.min(axis=0), cells.max(axis=0)
    width = int(high[1] - low[1] + 1)
    out.put_signed(low, _HEAD)
    out.put([width], _HEAD)
    flat = (cells[:, 0] - low[0]) * width + cells[:, 1] - low[1]
    gaps = np.diff(flat, prepend=0)
    starts = _starts(counts)
    gaps[starts] = flat[starts]
    out.put(gaps, _GAP)
    depths = made.depths[first:]
    steps = np.diff(depths, prepend=0)
    steps[starts[1:]] = np.diff(depths[starts])
    out.put_signed(steps, _DEPTH)


def _starts(counts: Ints) -> NDArray[np.intp]:
    """Row of the first point of each key-frame that has any."""
    ends = np.cumsum(counts)
    return (ends - counts)[counts > 0].astype(np.intp)


def _write_matches(out: BitWriter, base: QuantisedMap | None, made: QuantisedMap) -> None:
    """New matches alone where the base's are all still there, else all of them."""
    known = 0 if base is None else len(base.matches)
    kept = base is not None and np.array_equal(base.matches, made.matches[:known])
    known = known if kept else 0
    new, transforms = made.matches[known:], made.transforms[known:]
    out.put([int(kept), len(new)], _HEAD)
    out.put_signed(np.diff(new, axis=0, prepend=0), _MATCH)
    out.put_signed(transforms, _TRANSFORM)


def decode(
    owner: int, version: int, frame: FrameId, unit: float | None, base: QuantisedMap | None, data: bytes
) -> QuantisedMap:
    """The version that the bits make of a base; :class:`~maslam.mas.map_exchange.coding.rice.BitsError`
    where they make none. ``unit`` None: 1, and the map is not drifting.

    Descriptors are none: they travel beside.
    """
    columns = RIGID if unit is None else WITH_UNIT
    bits = BitReader(data)
    if base is None:
        try:
            steps = Steps(*(int(n) for n in bits.get_signed(_HEAD, 4)))
        except StepsError as error:
            raise CodingError(str(error)) from error
        base = empty_map(owner, frame, steps)
    if base.poses.shape[1] > columns:
        raise CodingError("a drifting map whose key-frames have no units")
    old = len(base.keyframes)
    fresh, mode = bits.one(_HEAD, MAX_KEYFRAMES - old), bits.one(_HEAD, ANEW)
    moved = widened(base.poses, columns)
    if mode == ANCHORS:
        moved = moved + _read_moves(bits, old, columns)
    before = int(base.keyframes[-1]) if old else -1
    keyframes = before + np.cumsum(bits.get(_INDEX, fresh) + 1)
    ticks = _read_ticks(bits, base.ticks, fresh)
    poses = moved[:0] if mode == ANEW else moved
    rest = bits.get_signed(_POSE[:columns], columns * (old + fresh - len(poses))).reshape(-1, columns)
    points = _read_points(bits, fresh)
    matches, transforms = _read_matches(bits, base)
    bits.end()
    made = QuantisedMap(
        owner,
        version,
        frame,
        1.0 if unit is None else unit,
        base.steps,
        np.concatenate([base.keyframes, keyframes]),
        np.concatenate([base.ticks, ticks]),
        _followed(poses, rest),
        np.concatenate([base.counts, points.counts]),
        np.concatenate([base.cells, points.cells]),
        np.concatenate([base.depths, points.depths]),
        None,
        matches,
        transforms,
    )
    if any(a.size and max(a.max(), -a.min()) > _LARGEST for a in (made.poses, made.cells, made.depths, made.ticks)):
        raise CodingError("numbers that no map holds")
    if (np.diff(made.ticks) <= 0).any():
        raise CodingError("time stamps out of order")
    if made.drifting and np.abs(made.poses[:, RIGID]).max(initial=0) * size(base.steps.rotation) > np.log(MAX_SCALE):
        raise CodingError("a key-frame whose unit is out of range")
    if len(keyframes) and (keyframes[0] <= before or (np.diff(keyframes) <= 0).any() or keyframes[-1] > _LOW):
        raise CodingError("key-frames out of order")
    return made


def _read_moves(bits: BitReader, old: int, columns: int) -> Ints:
    if not old:
        raise CodingError("corrections of key-frames that are not there")
    between = bits.one(_HEAD, old)
    inner = np.cumsum(bits.get(_HEAD, between) + 1)
    anchors = np.array(sorted({0, *inner.tolist(), old - 1}), dtype=np.intp)
    if len(anchors) != between + min(old, 2) or anchors[-1] != old - 1:
        raise CodingError("anchors that are not key-frames")
    steps = bits.get_signed(_MOVE[:columns], columns * len(anchors))
    moves = np.cumsum(steps.reshape(-1, columns), axis=0)
    return interpolated(moves, anchors, old)


def _read_ticks(bits: BitReader, known: Ints, fresh: int) -> Ints:
    if not fresh:
        return known[:0]
    if len(known):
        return known[-1] + np.cumsum(bits.get_signed(_TICK, fresh))
    high, low = int(bits.get_signed(_FIRST, 1)[0]), bits.one(_FIRST, _LOW - 1)
    ticks: Ints = np.cumsum(np.concatenate([[high * _LOW + low], bits.get_signed(_TICK, fresh - 1)]))
    return ticks


def _followed(poses: Ints, residuals: Ints) -> Ints:
    """Undo :func:`_expected`: residuals are changes of the step, but for the first pose of all and its first step."""
    if not len(poses):
        first = residuals[:1]
        return np.concatenate([first, first + np.cumsum(np.cumsum(residuals[1:], axis=0), axis=0)])
    step = poses[-1] - poses[-2] if len(poses) > 1 else 0
    return np.concatenate([poses, poses[-1] + np.cumsum(step + np.cumsum(residuals, axis=0), axis=0)])


@dataclass(frozen=True, eq=False)
class _NewPoints:
    """Points of new key-frames, as in :class:`~.quantised_map.QuantisedMap`."""

    counts: Ints
    cells: Ints
    depths: Ints


def _read_points(bits: BitReader, fresh: int) -> _NewPoints:
    counts = bits.get(_COUNT, fresh)
    total = int(counts.sum())
    if total > MAX_POINTS:
        raise CodingError(f"{total} points, at most {MAX_POINTS}")
    if not total:
        return _NewPoints(counts, np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64))
    low, width = bits.get_signed(_HEAD, 2), max(bits.one(_HEAD, _LOW), 1)
    starts = _starts(counts)
    gaps = bits.get(_GAP, total)
    reached = np.cumsum(gaps)
    flat = reached - np.repeat(reached[starts] - gaps[starts], counts[counts > 0])
    cells = np.column_stack([flat // width, flat % width]) + low
    steps = bits.get_signed(_DEPTH, total)
    first = np.cumsum(steps[starts])
    reached = np.cumsum(steps)
    depths = reached - np.repeat(reached[starts] - first, counts[counts > 0])
    return _NewPoints(counts, cells, depths)


def _read_matches(bits: BitReader, base: QuantisedMap) -> tuple[Ints, Ints]:
    kept, count = bits.one(_HEAD, 1), bits.one(_HEAD, MAX_KEYFRAMES)
    known = (base.matches, base.transforms) if kept else (base.matches[:0], base.transforms[:0])
    ids = np.cumsum(bits.get_signed(_MATCH, 3 * count).reshape(-1, 3), axis=0)
    if count and (ids.min() < 0 or ids[:, 1].max() >= MAX_AGENTS or ids.max() >= _LOW):
        raise CodingError("matches of nobody")
    transforms = bits.get_signed(_TRANSFORM, 7 * count).reshape(-1, 7)
    if count and np.abs(transforms[:, 6]).max() * size(base.steps.rotation) > np.log(MAX_SCALE):
        raise CodingError("a match whose scale is out of range")
    return np.concatenate([known[0], ids]), np.concatenate([known[1], transforms])
