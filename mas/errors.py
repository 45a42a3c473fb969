"""The errors of the multi-agent system, all of one root."""

from __future__ import annotations

from maslam.errors import MaslamError


class MasError(MaslamError):
    """A sequence, message or setting that cannot be used; the message says which and why in one line."""


class ProtocolError(MasError):
    """A message of another agent that cannot be acted on: the one kind of error in handling that is laid to a peer.

    Whatever else is raised while a message is handled is an error of this program, and stops it.
    """
