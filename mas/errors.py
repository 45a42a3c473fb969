"""The one exception root of the multi-agent system."""


class MasError(RuntimeError):
    """A sequence, message or setting that cannot be used; the message says which and why in one line."""
