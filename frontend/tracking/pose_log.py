"""Packed record of every frame: the one thing that grows with time and not with the map."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from ..reason import NO_REASON, Reason, Tally

Array = NDArray[np.float64]
_GAP = 2
"""Frames without a doubt between two doubtful ones that are of one interval, at most."""
_POSE = 12  # numbers: the upper three rows of a rigid transform


@dataclass(frozen=True)
class LostInterval:
    """No pose from ``first_ns`` to ``last_ns``, both included: ``frames`` frames. ``reason``: the most frequent one
    with its best figure, then the other kinds; ``kind``: the most frequent one without figures; ``kinds``: that of each
    frame in order, as runs ``(kind, frames)``, so that their frames add up to the interval's."""

    first_ns: int
    last_ns: int
    frames: int
    reason: str
    kind: str = ""
    kinds: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True)
class DoubtfulInterval:
    """Poses from ``first_ns`` to ``last_ns``, both included, that may be wrong: ``frames`` frames. ``reason``: the most
    frequent one with its worst figure, then the other kinds; ``kind``: the most frequent one without figures. A frame
    may be doubted for two reasons, by its points and as a jump, and one in a short gap for none."""

    first_ns: int
    last_ns: int
    frames: int
    reason: str
    kind: str


class PoseLog:
    """The tracked frames of one track, in order; 120 bytes per frame.

    Each frame's pose ``T_C_K`` ``(4, 4)`` is relative to a key-frame, so that it moves with it.
    """

    def __init__(self) -> None:
        self._index, self._stamp_ns, self._keyframe = array("q"), array("q"), array("q")
        self._T_C_K = array("d")

    def __len__(self) -> int:
        return len(self._index)

    def note(self, index: int, stamp_ns: int, keyframe: int, T_C_K: Array) -> None:
        """Record frame ``index`` relative to key-frame number ``keyframe``; a second record of a frame replaces the
        first."""
        if self._index and self._index[-1] == index:
            for column in (self._index, self._stamp_ns, self._keyframe):
                column.pop()
            del self._T_C_K[-_POSE:]
        self._index.append(index)
        self._stamp_ns.append(stamp_ns)
        self._keyframe.append(keyframe)
        self._T_C_K.frombytes(np.ascontiguousarray(T_C_K[:3], dtype=np.float64).tobytes())

    def keyframe(self, row: int) -> int:
        """Number of the key-frame that frame ``row`` of the log hangs on; negative rows count from the end."""
        return self._keyframe[row]

    def T_C_K(self, row: int) -> Array:
        """Pose ``(4, 4)`` of that key-frame in the frame's camera."""
        start = row % len(self) * _POSE
        return np.vstack([np.reshape(self._T_C_K[start : start + _POSE], (3, 4)), [0.0, 0.0, 0.0, 1.0]])

    def stamps_ns(self) -> NDArray[np.int64]:
        """``(N,)``, a copy."""
        return np.array(self._stamp_ns, dtype=np.int64)


@dataclass
class _Stretch:
    """Doubtful frames from number ``first`` to ``end``, that excluded."""

    first: int
    end: int
    tally: Tally


@dataclass
class _Refused:
    """Refused frames from number ``first`` to ``end``, that excluded; ``best``: of each kind the frame whose refusal
    came nearest, the latest of equals, and that refusal."""

    first: int
    end: int
    best: dict[str, tuple[int, Reason]]


class MomentLog:
    """Time of every frame offered, and the kind of its refusal where it was refused; 10 bytes per frame. Figures are
    kept of the refusals that came nearest, one of each kind in a stretch of refused frames."""

    def __init__(self) -> None:
        self._stamp_ns, self._kind = array("q"), array("H")
        self._kinds = [NO_REASON.kind]
        self._refused: list[_Refused] = []
        self._doubted: list[_Stretch] = []

    def __len__(self) -> int:
        return len(self._stamp_ns)

    @property
    def latest_ns(self) -> int | None:
        """Time stamp of the last frame, nanoseconds; None before the first."""
        return self._stamp_ns[-1] if self._stamp_ns else None

    def note(self, stamp_ns: int, refusal: Reason, doubt: Reason = NO_REASON) -> None:
        """One more frame; ``refusal`` why it has no pose, ``doubt`` why its pose may be wrong, or
        :data:`NO_REASON`."""
        number = len(self)
        self._stamp_ns.append(stamp_ns)
        if refusal.kind not in self._kinds:
            self._kinds.append(refusal.kind)
        self._kind.append(self._kinds.index(refusal.kind))
        if refusal.kind:
            self._refuse(number, refusal)
        if doubt.kind:
            if not self._doubted or self._doubted[-1].end < number:
                self._doubted.append(_Stretch(number, number, Tally()))
            self._doubted[-1].tally.add(doubt)
            self._doubted[-1].end = number + 1

    def _refuse(self, number: int, refusal: Reason) -> None:
        if not self._refused or self._refused[-1].end < number:
            self._refused.append(_Refused(number, number, {}))
        stretch = self._refused[-1]
        stretch.end = number + 1
        best = stretch.best.get(refusal.kind)
        if best is None or refusal.reached >= best[1].reached:
            stretch.best[refusal.kind] = number, refusal

    def lost(self, posed_ns: Sequence[NDArray[np.int64]], unsaid: Callable[[], Reason]) -> list[LostInterval]:
        """Runs of frames whose times are in none of ``posed_ns``; ``unsaid`` gives the reason of frames of which none
        was noted. Each frame has one reason: a frame that got its pose later, as the first view of a track, parts a
        stretch of refused ones."""
        stamps = np.array(self._stamp_ns, dtype=np.int64)
        missing = ~np.isin(stamps, np.concatenate([np.zeros(0, dtype=np.int64), *posed_ns]))
        edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(np.int8)))
        return [self._interval(first, end, unsaid) for first, end in edges.reshape(-1, 2).tolist()]

    def _interval(self, first: int, end: int, unsaid: Callable[[], Reason]) -> LostInterval:
        tally, runs = Tally(), list[tuple[str, int]]()
        for code, same in groupby(self._kind[first:end]):
            refusal = self._nearest(self._kinds[code], first, end) if code else unsaid()
            runs.append((refusal.kind, len(list(same))))
            tally.add(refusal, runs[-1][1])
        main, times = tally.main(), (self._stamp_ns[first], self._stamp_ns[end - 1])
        assert main is not None
        return LostInterval(*times, end - first, tally.text(), main[1].kind, tuple(runs))

    def _nearest(self, kind: str, first: int, end: int) -> Reason:
        """The refusal of this kind that came nearest among these frames, as far as it was kept; else the kind alone."""
        known = [s.best[kind] for s in self._refused if s.first < end and s.end > first and kind in s.best]
        inside = [best for number, best in known if first <= number < end]
        return max(inside[::-1], key=lambda refusal: refusal.reached, default=Reason(kind, kind))

    def doubtful(
        self, posed_ns: Sequence[NDArray[np.int64]], later: Iterable[tuple[int, Reason]]
    ) -> list[DoubtfulInterval]:
        """Runs of doubtful frames among those posed, joined over gaps of a few frames; ``later``: time and doubt of
        frames that the whole trajectory made doubtful. ``frames`` counts the doubtful ones."""
        stamps = np.array(self._stamp_ns, dtype=np.int64)
        posed = np.isin(stamps, np.concatenate([np.zeros(0, dtype=np.int64), *posed_ns]))
        stretches = [_Stretch(s.first, s.end, s.tally) for s in self._doubted if posed[s.first : s.end].any()]
        for stamp_ns, reason in later:
            number = int(np.searchsorted(stamps, stamp_ns))
            stretches.append(_Stretch(number, number + 1, Tally()))
            stretches[-1].tally.add(reason)
        merged: list[_Stretch] = []
        for stretch in sorted(stretches, key=lambda s: (s.first, s.end)):
            if not merged or merged[-1].end + _GAP < stretch.first:
                merged.append(_Stretch(stretch.first, stretch.end, Tally()))
            merged[-1].tally.merge(stretch.tally)
            merged[-1].end = max(merged[-1].end, stretch.end)
        out = []
        for one in merged:
            main, times = one.tally.main(), stamps[one.first : one.end][posed[one.first : one.end]]
            assert main is not None
            text = one.tally.text("worst")
            out.append(DoubtfulInterval(int(times[0]), int(times[-1]), len(times), text, main[1].kind))
        return out
