"""The root of all errors that maslam raises on purpose."""

from __future__ import annotations


class MaslamError(RuntimeError):
    """Input or a setting that cannot be used. The message says which and why in one line.

    Each folder has an error of its own below this one: ``FrontendError``, ``DescriptorError``, ``BackendError``,
    ``MasError``, ``ToolError``. Anything else that is raised is a defect of the program.
    """
