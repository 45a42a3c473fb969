"""The one error of the front end."""

from __future__ import annotations

from maslam.errors import MaslamError


class FrontendError(MaslamError):
    """Input that cannot be used; the message names file, line, number and unit in one line."""
