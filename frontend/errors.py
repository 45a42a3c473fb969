"""The error of the front end, and the kind of it that others tell apart."""

from __future__ import annotations

from maslam.errors import MaslamError


class FrontendError(MaslamError):
    """Input that cannot be used; the message names file, line, number and unit in one line."""


class ImageSizeError(FrontendError):
    """An image that is whole, and of another size than its sequence."""
