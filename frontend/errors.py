"""The one exception root of the front end."""


class FrontendError(RuntimeError):
    """Input that cannot be used; the message names file, line, number and unit in one line."""
