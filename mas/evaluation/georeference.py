"""Where a group's frame lies in the frame of the positions measured from outside (GPS): one rigid transform, with one
camera's unit of length a similarity, that lays all antennas of the group on their positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, Sim3, skew, so3_exp, umeyama

from ..agent import Agent
from ..config import MasConfig
from ..manifest import Manifest
from ..state.positions import knows_positions
from .ground_truth import groups_of
from .summary import DatumFigures, GeoreferenceFigures, PositionFigures

_LEAST_FIXES = 3
_MOST_TURN_DEG = 5.0
"""A frame whose rotation is known no better than this has no place: its positions lie on a line, or too near."""
_ROUNDS, _SETTLED = 60, 1e-10
_FAR_SIGMAS = 3.0
_UNITS = {1e3: "millimetres", 1e2: "centimetres", 1e-3: "kilometres"}
_ALIKE = (0.7, 1.4)


@dataclass(frozen=True, eq=False)
class MeasuredPoints:
    """n antennas: ``points`` ``(n, 3)`` in a group's frame, where they were measured, ``enu`` ``(n, 3)``, and the noise
    of each axis there, ``sigma`` ``(n, 3)``."""

    points: Array
    enu: Array
    sigma: Array


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """``T_E_F``: the frame in that of the positions; ``distance`` ``(n,)`` of each position from it, standard
    deviations; ``rotation_sigma``: of the rotation about its worst axis, radians."""

    T_E_F: Sim3
    distance: Array
    rotation_sigma: float


@dataclass(frozen=True, eq=False)
class Georeference:
    """``T_E_F``: the group's frame in metres east, north and up; None where positions do not tell it. ``figures``: of
    the fit."""

    T_E_F: Sim3 | None
    figures: GeoreferenceFigures


def georeferences(agents: Sequence[Agent]) -> list[Georeference]:
    """Of each group of agents that has any positions."""
    found = []
    for group in groups_of(agents):
        measured = _fixes([agents[i] for i in group])
        if len(measured.points):
            metric = all(p.metric for i in group for p in agents[i].state.pieces if p.frame == agents[i].state.frame)
            found.append(_of_group(group, measured, not metric))
    return found


def datum_of(manifest: Manifest) -> DatumFigures | None:
    """The place that the agents' positions count from; None where they were given in metres."""
    origin = manifest.settings.get("gps", {}).get("origin")
    if origin is None:
        return None
    latitude, longitude, altitude = (float(value) for value in origin)
    return DatumFigures(latitude_deg=latitude, longitude_deg=longitude, altitude_m=altitude)


def position_figures(
    groups: Sequence[Georeference], datum: DatumFigures | None, config: MasConfig
) -> PositionFigures | None:
    """For ``summary.json``; None where no agent had positions."""
    if not groups:
        return None
    used = knows_positions(config.optimisation)
    return PositionFigures(datum=datum, used=used, groups=[one.figures for one in groups])


def fit_frame(measured: MeasuredPoints, with_scale: bool) -> FittedFrame:
    """The frame that lays points on their positions, each axis by its own noise, those far off counted less and less;
    one at least."""
    points, enu, sigma = measured.points, measured.enu, measured.sigma
    T = umeyama(enu, points, with_scale)
    size = 7 if with_scale else 6
    information = np.zeros((size, size))
    for _ in range(_ROUNDS):
        turned = T.scale * points @ T.rotation.T
        off = (enu - turned - T.translation) / sigma
        weight = 1.0 / (1.0 + ((off**2).sum(axis=1) / 3.0 / _FAR_SIGMAS**2))
        J = np.zeros((len(points), 3, size))
        J[:, :, :3] = np.eye(3)
        J[:, :, 3:6] = -skew(turned)
        if with_scale:
            J[:, :, 6] = turned
        J /= sigma[:, :, None]
        information = np.einsum("n,nai,naj->ij", weight, J, J)
        step = np.linalg.lstsq(information, np.einsum("n,nai,na->i", weight, J, off), rcond=1e-12)[0]
        growth = float(np.exp(np.clip(step[6], -1.0, 1.0))) if with_scale else 1.0
        T = Sim3(so3_exp(step[3:6]) @ T.rotation, T.translation + step[:3], T.scale * growth)
        if np.abs(step).max() < _SETTLED:
            break
    rest = [k for k in range(size) if k not in (3, 4, 5)]
    across = information[np.ix_([3, 4, 5], rest)]
    turns = information[3:6, 3:6] - across @ np.linalg.pinv(information[np.ix_(rest, rest)]) @ across.T
    least = float(np.linalg.eigvalsh(0.5 * (turns + turns.T))[0])
    off = (enu - T @ points) / sigma
    return FittedFrame(T, np.sqrt((off**2).sum(axis=1) / 3.0), float(1.0 / np.sqrt(max(least, 1e-12))))


def _fixes(agents: Sequence[Agent]) -> MeasuredPoints:
    rows: list[tuple[NDArray[np.float64], ...]] = []
    for state in (agent.state for agent in agents):
        for index in state.placed():
            for fix in state.keyframes[index].fixes:
                rows.append((state.pose(index) @ fix.lever, fix.enu, fix.sigma))
    return MeasuredPoints(*(np.array([row[k] for row in rows]).reshape(-1, 3) for k in range(3)))


def _of_group(group: list[int], measured: MeasuredPoints, with_scale: bool) -> Georeference:
    count = len(measured.points)
    if count < _LEAST_FIXES:
        why = f"{count} positions while frames have a place; {_LEAST_FIXES} are the fewest"
        return Georeference(None, GeoreferenceFigures(agents=group, positions=count, reason=why))
    fit = fit_frame(measured, with_scale)
    T, turn, near = fit.T_E_F, fit.rotation_sigma, fit.distance <= _FAR_SIGMAS
    square = (measured.enu - T @ measured.points)[near] ** 2
    reason = "" if with_scale else _other_unit(measured)
    if not reason and not near.any():
        reason = "no position is within three standard deviations of the map"
    elif not reason and np.degrees(turn) > _MOST_TURN_DEG:
        reason = "positions on a line, or too near to each other, do not tell how the map is turned"
    figures = GeoreferenceFigures(
        agents=group,
        positions=count,
        far_off=int(count - near.sum()),
        rms_horizontal_m=float(np.sqrt(square[:, :2].sum(axis=1).mean())) if near.any() else None,
        rms_vertical_m=float(np.sqrt(square[:, 2].mean())) if near.any() else None,
        scale=float(T.scale),
        rotation_sigma_deg=float(min(np.degrees(turn), 180.0)),
        reason=reason,
    )
    return Georeference(None if reason else T, figures)


def _other_unit(measured: MeasuredPoints) -> str:
    """Why positions cannot be metres, where they lie a unit's factor farther apart than the map; else empty. Medians:
    a few wild fixes do not count. A map that spreads less than the noise tells nothing."""
    both = (measured.points, measured.enu)
    mine, theirs = (float(np.median(np.linalg.norm(p - np.median(p, axis=0), axis=1))) for p in both)
    ratio = theirs / mine if mine > float(np.median(measured.sigma)) else 0.0
    unit = next((name for factor, name in _UNITS.items() if _ALIKE[0] < ratio / factor < _ALIKE[1]), "")
    return f"they lie {ratio:.4g} times as far apart as the map: in {unit}? metres are meant" if unit else ""
