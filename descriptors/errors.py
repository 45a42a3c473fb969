"""The one error of the place descriptors."""

from __future__ import annotations

from maslam.errors import MaslamError


class DescriptorError(MaslamError):
    """A model, image or vector file that cannot be used; the message says which and why in one line."""
