"""Positions of a satellite receiver in a bag: NavSatFix messages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import FrontendError
from ...files.geodetic_fixes import GeodeticFixes
from ...files.positions import PositionFixes, of_receiver
from .bag import Bag
from .message_file import Topic

NAV_SAT_FIX = "sensor_msgs/msg/NavSatFix"
NO_TOPIC = "none"
"""As the name of a topic: positions in a bag are not read."""
_OPTION = "--recording.gps-topic"


def choose_fixes(
    path: Path, topics: Sequence[Topic], wanted: str | None, shared: Sequence[int], alone: bool
) -> tuple[Topic | None, list[str]]:
    """The topic of positions of one robot, and what to say where several are its.

    ``topics`` of NavSatFix, ``shared``: how many first parts of their names are those of its images; ``alone``: it is
    the bag's only robot, whose topics need none. ``wanted``: what the user named. :class:`FrontendError` where that is
    not there.
    """
    if wanted == NO_TOPIC:
        return None, []
    found = [(count, topic) for count, topic in zip(shared, topics, strict=True) if topic.count and (count or alone)]
    if wanted is not None:
        ends = "/" + wanted.strip("/")
        found = [(count, topic) for count, topic in found if ("/" + topic.name.strip("/")).endswith(ends)]
        if not found:
            names = ", ".join(topic.name for topic in topics) or "none"
            raise FrontendError(f"{path}: no topic of positions {wanted}: there are {names}")
    most = max((count for count, _ in found), default=0)
    nearest = [topic for count, topic in found if count == most]
    if len(nearest) > 1:
        names = ", ".join(f"{topic.name} ({topic.count})" for topic in nearest)
        return None, [f"{path}: several topics of positions ({names}); {_OPTION} names one: read without them"]
    return (nearest[0], []) if nearest else (None, [])


def read_fixes(bag: Bag, topic: Topic) -> tuple[PositionFixes | None, list[str]]:
    """The positions of a topic at the times of their headers, and what was left out. Noise that the receiver does not
    tell is NaN. None where it had no fix."""
    messages = bag.messages(topic)
    stamps: list[int] = []
    rows, sigma, lines = [], [], []
    without = repeated = 0
    for i, stamp in enumerate(messages.stamps_ns.tolist()):
        message = bag.read(messages, i, topic)
        place = np.array([message.latitude, message.longitude, message.altitude], dtype=np.float64)
        if message.status.status < 0 or not np.isfinite(place[:2]).all() or np.abs(place[:2]).max() > 360:
            without += 1
            continue
        if stamps and stamp <= stamps[-1]:
            repeated += 1
            continue
        variance = np.asarray(message.position_covariance, dtype=np.float64)[[0, 4, 8]]
        known = message.position_covariance_type != 0 and bool((variance > 0).all())
        stamps.append(stamp)
        rows.append(np.nan_to_num(place))
        sigma.append(np.sqrt(variance) if known else np.full(3, np.nan))
        lines.append(i)
    left_out = [(without, "without a fix"), (repeated, "with the time of another")]
    notes = [f"{count} of {len(messages.stamps_ns)} messages {what} left out" for count, what in left_out if count]
    if not stamps:
        return None, [f"{bag.path}: {topic.name}: no positions: {'; '.join(notes)}"]
    fixes = GeodeticFixes(np.array(stamps, dtype=np.int64), np.array(rows), np.array(sigma), lines, tuple(notes))
    return of_receiver(fixes, f"{bag.path}: {topic.name}"), []
