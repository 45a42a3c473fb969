"""Bytes between one agent and another, by direction and by what they are for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from .framing import Frame, MessageBundle, MessagePiece


@dataclass
class LinkBytes:
    """One direction. ``message_bytes``: of messages, once each; ``data_bytes``: of the frames that they travel in, with
    their codes and with pieces that were sent again; ``control_bytes``: of frames that acknowledge, say how far an
    agent is, or pass a list on; ``greeting_bytes``: of certificates and keys that are shown when two meet. ``frames``:
    how many of data and control. What TLS, QUIC and Zenoh add is not in it."""

    message_bytes: int = 0
    data_bytes: int = 0
    control_bytes: int = 0
    greeting_bytes: int = 0
    frames: int = 0

    def count(self, frame: Frame, size: int) -> None:
        """A frame of ``size`` bytes, with its code."""
        self.frames += 1
        if isinstance(frame, MessageBundle | MessagePiece):
            self.data_bytes += size
        else:
            self.control_bytes += size

    @property
    def frame_bytes(self) -> int:
        """Of data and control."""
        return self.data_bytes + self.control_bytes

    def __add__(self, other: LinkBytes) -> LinkBytes:
        mine, others = asdict(self), asdict(other)
        return LinkBytes(**{name: mine[name] + others[name] for name in mine})


def total_bytes(links: Mapping[int, LinkBytes]) -> LinkBytes:
    """Of all neighbours."""
    return sum(links.values(), LinkBytes())


def link_figures(out: Mapping[int, LinkBytes], into: Mapping[int, LinkBytes]) -> dict[str, Any]:
    """For ``process.json``: ``sent``, ``received``: by the other agent's number, and in all."""
    sides = (("sent", out), ("received", into))
    return {
        name: {"all": asdict(total_bytes(links)), **{str(other): asdict(one) for other, one in sorted(links.items())}}
        for name, links in sides
    }
