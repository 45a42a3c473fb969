"""The one exception root of the back end."""


class BackendError(RuntimeError):
    """A graph or file that cannot be used; the message says which and why in one line."""
