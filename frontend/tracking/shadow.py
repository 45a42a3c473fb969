"""A track that began where something nearer hid what the one before saw: it may follow that, and not the camera."""

from __future__ import annotations

from dataclasses import dataclass

from ..reason import NO_REASON, Reason
from .carried import CARRIED
from .track import Segment

_NEARER = 0.5
"""Share of the depth of the view before, below which something hides it."""
_FRAMES = 60
"""Frames for which a track without metres is doubted: its depth cannot be compared."""


@dataclass(frozen=True)
class Shadow:
    """``depth_m``: median depth of the view that was hidden; None without metres."""

    depth_m: float | None

    @classmethod
    def over(cls, before: Segment, begun: Segment, sudden: bool) -> Shadow | None:
        """That over a track ``begun`` after ``before`` was lost; None where nothing seems to hide its view. ``sudden``:
        it was lost although its camera hardly moved, or since something else did."""
        if not begun.tracker.ranging.rig.metric:
            return cls(None) if sudden or before.tracker.standing.rested else None
        depth_m = before.view_depth()
        return cls(depth_m) if begun.view_depth() < _NEARER * depth_m else None

    def refusal(self, begun: Segment) -> Reason:
        """Why no track begins here yet: what hides the view may pass."""
        if self.depth_m is None:
            return NO_REASON
        now_m = begun.view_depth()
        text = f"lost: what is seen lies {now_m:.3g} m away, what was seen before {self.depth_m:.3g} m"
        return Reason(CARRIED, text, now_m / (_NEARER * self.depth_m))

    def doubt(self, begun: Segment) -> Reason:
        """Why the track may be wrong, as long as its view does not reach as far as the one before."""
        if self.depth_m is None:
            text = f"{CARRIED}: the track began there"
            return Reason(CARRIED, text, 1.0) if len(begun.frames) <= _FRAMES else NO_REASON
        now_m = begun.view_depth()
        if now_m >= _NEARER * self.depth_m:
            return NO_REASON
        text = f"{CARRIED}: the track began there, seeing {now_m:.3g} m far instead of {self.depth_m:.3g} m"
        return Reason(CARRIED, text, _NEARER * self.depth_m / max(now_m, 1e-9))
