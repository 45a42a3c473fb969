"""Multi-agent visual SLAM without a server.

The code stands in five folders beside this one: ``frontend``, ``descriptors``, ``backend``, ``mas`` and ``tools``. They
are reached through the links in this folder and under no other name: ``from maslam.backend.geometry import Sim3``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str

__all__ = ["__version__"]


def __getattr__(name: str) -> str:
    """Look ``__version__`` up when first asked for: reading the installed metadata takes longer than the import."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import version

    return version("maslam")
