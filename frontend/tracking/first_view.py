"""The first view of a monocular start: its corners followed from frame to frame, and the motion that they give away
(thesis section 2.1.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..config import MonoConfig, OdometryConfig
from ..estimation.several_views import Needs, SeveralViews, ViewTracks, adjust_all, contradicted, decide
from ..estimation.two_view import PointPairs, solve_two_views
from ..frames import Frame
from ..mapping.range_sensor import Ranging
from ..reason import Reason

Array = NDArray[np.float64]
_BETWEEN = 4
"""Views kept between the first and the latest, at most; every other one goes where they become more."""
_AGREEING = 0.75
_PATIENCE, _LEFT = 3, 0.6
"""Two views make a better map: more are asked when so many frames have passed, or so few corners are left."""
"""Share of the points followed that must agree in all views."""
_STILL, _STILL_SIGMAS = 0.25, 4.0
"""Share of points that may have moved by less than so many standard deviations when most have moved far."""
_STILL_RESTED, _FEWEST, _WIDE = 0.01, 4, 0.5
"""The same share where the camera stood just before, of so many points that are spread over this part of the image's
width or height: something has come before it, and it does not leave in the same moment."""
_STANDING = 0.9
"""Share of the points that have moved by no more than that where the camera is said to stand."""
STATIC, MOVED_LITTLE = "the camera stands still", "moved too little to start"
UNMOVED = STATIC, MOVED_LITTLE
"""Refusals of a first view that goes on: sooner or later the camera moves."""
_WAITING = Reason("waiting for a third view", "waiting for a third view to confirm the motion")


class FirstView:
    """Corners of ``frame`` that are followed: ``first_uv`` ``(n, 2)`` pixels there, ``uv`` ``(n, 2)`` in the latest
    frame. ``rested``: whether the camera was seen to stand, by these or by those before, and has not moved since."""

    def __init__(self, frame: Frame, uv: Array, ranging: Ranging, config: OdometryConfig, rested: bool = False) -> None:
        self.frame, self.first_uv, self.uv, self.rested = frame, uv, uv, rested
        self.ranging, self.config = ranging, config
        self._between: list[Array] = []
        self._begun, self._frames = len(uv), 0

    def __len__(self) -> int:
        return len(self.uv)

    @property
    def left(self) -> float:
        """Share of its corners that is still followed."""
        return len(self) / self._begun

    @property
    def flow_px(self) -> float:
        """Median displacement since the first view."""
        return float(np.median(np.linalg.norm(self.uv - self.first_uv, axis=1)))

    def follow(self, uv: Array, ok: NDArray[np.bool_]) -> None:
        """The corners are at ``uv`` ``(n, 2)`` in the next frame, where ``ok`` ``(n,)``; the others are lost."""
        self._frames += 1
        if self._frames > 1:
            self._between.append(self.uv)
        if len(self._between) > _BETWEEN:
            self._between = self._between[1::2]
        self._between = [before[ok] for before in self._between]
        self.first_uv, self.uv = self.first_uv[ok], uv[ok]

    def motion(self) -> SeveralViews:
        """The motion from the first view to the latest: from these two alone where no other explains the views between
        as well; from all views where two have less than they need, or leave a doubt."""
        mono = self.config.mono
        need_px = mono.min_flow_px * self.ranging.rig.camera.width / 640
        refusal = self._too_little(need_px)
        if refusal is not None:
            return self._refused(refusal)
        uv = np.stack([self.ranging.ideal(at) for at in (self.first_uv, *self._between, self.uv)])
        tracks = ViewTracks(uv, self.ranging.cam, self.config.pose.pixel_sigma_px)
        two = solve_two_views(PointPairs(uv[0], uv[-1], self.ranging.rig.camera.K, tracks.sigma_px), mono)
        enough = len(self) >= mono.min_matches and self.flow_px >= need_px
        sure = two.T_2_1 is not None and enough
        if not sure and self._patient():
            return self._refused(_WAITING if two.T_2_1 is not None else two.refusal)
        fits = adjust_all(tracks, two.hypotheses) if not sure or len(two.hypotheses) > 1 else []
        if sure and two.T_2_1 is not None and not contradicted(fits, two.T_2_1):
            return SeveralViews(two.T_2_1, two.points, two.good)
        if not fits:
            return self._refused(two.refusal)
        share = mono.several_views
        return decide(tracks, fits, Needs(round(share * mono.min_points), _AGREEING, share * mono.min_parallax_deg))

    def _patient(self) -> bool:
        """Whether two views may still have what they need before the corners are lost."""
        early = self._frames < _PATIENCE and self.left > _LEFT and len(self) >= self.config.mono.min_matches
        return early or not self._between

    def _refused(self, refusal: Reason) -> SeveralViews:
        return SeveralViews.refused(len(self), refusal)

    def _too_little(self, need_px: float) -> Reason | None:
        """What even several views could not do without: points and displacement, of which two need ``need_px``."""
        mono = self.config.mono
        if len(self) < least_matches(mono):
            return Reason.few(
                "too few points followed", len(self), least_matches(mono), "points followed from the first view"
            )
        flow, least_px = self.flow_px, mono.several_views * need_px
        if flow < least_px:
            kind = STATIC if self._standing() else MOVED_LITTLE
            self.rested = self.rested or kind == STATIC
            text = f"{kind}: the points have moved by {flow:.2f} px (median), need {least_px:.1f} px"
            return Reason(kind, text, flow / least_px)
        still = self._still(flow)
        bound = _STILL_RESTED if self.rested and self._wide(still) else _STILL
        share = float(still.mean())
        if share > bound:
            what = f"{100 * share:.0f} % of the points stand still"
            text = f"{what}, {100 * bound:.0f} % at most: something moves, not the camera"
            return Reason("a part of the image stands still", text, bound / share)
        self.rested = False
        return None

    def _wide(self, still: NDArray[np.bool_]) -> bool:
        """Whether points lie all around: what a camera moves towards stands still, too, but in one place."""
        camera = self.ranging.rig.camera
        if still.sum() < _FEWEST:
            return False
        return bool((np.ptp(self.uv[still], axis=0) > _WIDE * np.array([camera.width, camera.height])).any())

    def _standing(self) -> bool:
        """Whether the points are where they were, within their noise."""
        moved = np.linalg.norm(self.uv - self.first_uv, axis=1)
        return float((moved < _STILL_SIGMAS * self.config.pose.pixel_sigma_px).mean()) >= _STANDING

    def _still(self, flow_px: float) -> NDArray[np.bool_]:
        """Points that never left their place: what a standing camera sees behind something that moves."""
        bound = min(_STILL_SIGMAS * self.config.pose.pixel_sigma_px, 0.25 * flow_px)
        moved = np.linalg.norm(np.stack([*self._between, self.uv]) - self.first_uv, axis=2)
        return np.asarray(np.median(moved, axis=0) < bound)


def least_matches(mono: MonoConfig) -> int:
    """Fewest points followed with which a track may start, several views agreeing."""
    return round(mono.several_views * mono.min_matches)
