"""The one error of the multi-agent system."""

from __future__ import annotations

from maslam.errors import MaslamError


class MasError(MaslamError):
    """A sequence, message or setting that cannot be used; the message says which and why in one line."""
