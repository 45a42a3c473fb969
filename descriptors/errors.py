"""The one exception root of the place descriptors."""


class DescriptorError(RuntimeError):
    """A model, image or vector file that cannot be used; the message says which and why in one line."""
