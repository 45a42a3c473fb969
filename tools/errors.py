"""The one exception root of the commands."""


class ToolError(RuntimeError):
    """A folder, file or option that a command cannot use; the message says which and why in one line."""


class UsageError(ToolError):
    """Options that do not fit together: exit code 2 instead of 1."""
