"""Corrections that the elected robot sends to a member: the places of its shared poses, as bytes.

A place is sent in steps from where the correction of the pose before it would bring it. So a robot that moves as a
whole costs next to nothing, and a pose of which the member knows no earlier place is sent in full.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np

from ...errors import BackendError
from ...geometry import Array, project_to_so3, se3_inverse
from ...pose_graph.graph import NodeId
from ..compact import CompactReader, CompactWriter, numbers_of, poses_of
from ..condense import Known
from ..place_steps import Place, place_from_steps, place_to_steps


def chained(chain: int, body: bytes) -> int:
    """Checksum of all corrections so far: whoever has another has another state."""
    return zlib.crc32(body, chain) & 0xFFFF


def encode_correction(
    nodes: Sequence[NodeId], places: Known, before: Known, sizes: Array | None, scaled: bool
) -> tuple[bytes, Known]:
    """Bytes, and the places that the member will read. ``before``: places that it knows, whatever their age; ``sizes``
    ``(3,)`` of steps: of shifts, turns and log units; None: all in full."""
    out, read = CompactWriter(), Known()
    rounded = np.zeros(3) if sizes is None else sizes.astype(np.float32).astype(np.float64)
    for size in rounded[: 3 if scaled else 2]:
        out.rough(float(size))
    correction, grown, index = np.eye(4), 0.0, 0
    for n in nodes:
        T, unit = places.poses[n], places.log_units.get(n, 0.0)
        full = sizes is None or n not in before.poses
        out.count(2 * (n.index - index) + full)
        index = n.index
        if full:
            out.pose(T)
            if scaled:
                out.number(unit)
            read.poses[n], read.log_units[n] = poses_of(numbers_of(T)), unit
        else:
            predicted = correction @ before.poses[n], before.log_units[n] + grown
            steps = place_to_steps(T, unit, predicted, _for_numbers(rounded))[: 7 if scaled else 6]
            out.steps(steps.tolist())
            read.poses[n], read.log_units[n] = _moved(steps, predicted, rounded)
        if n in before.poses:
            correction = read.poses[n] @ se3_inverse(before.poses[n])
            grown = read.log_units[n] - before.log_units[n]
    return out.bytes(), read


def decode_correction(data: bytes, robot: int, before: Known, scaled: bool) -> Known:
    """Inverse of :func:`encode_correction`; :class:`BackendError` where its numbers cannot be."""
    source, read = CompactReader(data), Known()
    rounded = np.zeros(3)
    for k in range(3 if scaled else 2):
        rounded[k] = source.rough()
    correction, grown, index = np.eye(4), 0.0, 0
    while not source.empty:
        more, full = divmod(source.count(), 2)
        index += more
        n = NodeId(robot, index)
        if full:
            read.poses[n], read.log_units[n] = source.pose(), source.number() if scaled else 0.0
        elif n not in before.poses:
            raise BackendError(f"a correction of {n} in steps from a place that robot {robot} does not know")
        else:
            predicted = correction @ before.poses[n], before.log_units[n] + grown
            steps = np.array(source.steps(7 if scaled else 6), dtype=np.float64)
            read.poses[n], read.log_units[n] = _moved(steps, predicted, rounded)
        if n in before.poses:
            correction = read.poses[n] @ se3_inverse(before.poses[n])
            grown = read.log_units[n] - before.log_units[n]
    numbers = np.array([*read.poses.values()]).ravel()
    if not np.isfinite(numbers).all() or not np.isfinite([*read.log_units.values()]).all():
        raise BackendError("a correction is not finite")
    return read


def _moved(steps: Array, predicted: Place, sizes: Array) -> Place:
    """The place that the steps lead to. Its rotation is made one again: what products of many leave off would grow
    from correction to correction."""
    T, unit = place_from_steps(steps, predicted, _for_numbers(sizes))
    T[:3, :3] = project_to_so3(T[:3, :3])
    return T, float(unit)


def _for_numbers(sizes: Array) -> Array:
    """Sizes ``(7,)`` of the steps of each number."""
    return np.repeat(sizes, (3, 3, 1))
