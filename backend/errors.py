"""The one error of the back end."""

from __future__ import annotations

from maslam.errors import MaslamError


class BackendError(MaslamError):
    """A graph or file that cannot be used; the message says which and why in one line."""
