"""The one exception of the synthetic worlds."""

from ..common.errors import ToolError


class RenderError(ToolError):
    """A rendering that cannot be made as asked; the message says in one line what and why, with numbers and units."""
