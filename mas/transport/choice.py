"""Transports by name or as a user's object."""

from __future__ import annotations

from collections.abc import Callable

from maslam.extensions import ExtensionGroup, check_name, load_extension, made, name_of

from .transport import InProcessTransport, Transport

TransportLike = Transport | type[Transport] | Callable[[], Transport]
"""A transport, or what makes one."""
IN_PROCESS = "in_process"


def check_transport(name: str) -> None:
    """Refuse a name that is not ours and no entry point's."""
    check_name(ExtensionGroup.TRANSPORTS, "transport", name, [IN_PROCESS])


def transport_of(given: TransportLike | str) -> Transport:
    """The transport given, or a new one by its name."""
    if given == IN_PROCESS:
        return InProcessTransport()
    if isinstance(given, str):
        check_transport(given)
        name, extension = given, load_extension(ExtensionGroup.TRANSPORTS, given)
    else:
        name, extension = name_of(given), given
    return made(extension, Transport, f"transport {name}")  # type: ignore[type-abstract]
