"""The stiffness of a track between two knots: a chain of edges, one after the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...central.similarity_edges import SimilarityEdges
from ...geometry import Array
from ..places import Places
from .knots import Hats, arms


def tracks(
    stops: NDArray[np.intp], hats: Hats, centres: Array, edges: SimilarityEdges, places: Places, width: int
) -> tuple[NDArray[np.intp], Array]:
    """Knots from which ``edges`` between one row and the next lead to the next knot, and the stiffness ``(l, w, w)`` of
    the way there: of the difference of both knots' motions, about the point between both ends.

    ``stops`` ``(s,)``: rows that move as their ``hats`` say, all others follow. From stop to stop each edge gives way
    by itself, so compliances add up, each as an arm carries it.
    """
    first = edges.ends.min(axis=1)
    tau = edges.tau * np.exp(-2.0 * places.log_units[edges.ends[:, 0]])
    size = int(edges.ends.max(initial=0)) + 1
    stiff = np.zeros((size, 3))
    np.add.at(stiff, first, np.stack([tau, 2.0 * edges.kappa, edges.precision], axis=1))
    found: dict[int, list[tuple[Array, Array, float]]] = {}
    place = hats.first + hats.weight
    for k in range(len(stops) - 1):
        rows, rise = np.arange(stops[k], stops[k + 1]), float(place[k + 1] - place[k])
        if hats.first[k] < 0 or not 0.0 < rise <= 1.0 or rows[-1] >= size or not (stiff[rows] > 0).all():
            continue
        middle = 0.5 * (places.poses[stops[k], :3, 3] + places.poses[stops[k + 1], :3, 3])
        arm = arms(np.broadcast_to(middle, (len(rows), 3)), places.poses[rows + 1, :3, 3], width)
        give = np.repeat(1.0 / stiff[rows], (3, 3, 1), axis=1)[:, :width]
        compliance = ((arm * give[:, None, :]) @ np.swapaxes(arm, 1, 2)).sum(axis=0)
        found.setdefault(int(hats.first[k]), []).append((middle, np.linalg.inv(compliance), rise))
    links = []
    for knot in sorted(found):
        point = 0.5 * (centres[knot] + centres[knot + 1])
        links.append(sum(_about(point, *part) for part in found[knot]))
    return np.array(sorted(found), dtype=np.intp), np.array(links).reshape(-1, width, width)


def _about(point: Array, middle: Array, stiffness: Array, rise: float) -> Array:
    """What a part's stiffness about its ``middle`` is about ``point``, of the motion of which it takes the share
    ``rise``."""
    arm = arms(middle[None], point[None], len(stiffness))[0]
    return np.asarray(rise**2 * (arm.T @ stiffness @ arm))
