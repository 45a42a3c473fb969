"""Transports by name or as a user's object."""

from __future__ import annotations

from collections.abc import Callable

from maslam.extensions import ExtensionGroup, installed, load_extension, made, name_of, unknown

from ..errors import MasError
from .transport import InProcessTransport, Transport

TransportLike = Transport | type[Transport] | Callable[[], Transport]
"""A transport, or what makes one."""
IN_PROCESS = "in_process"


def check_transport(name: str) -> None:
    """Refuse a name that is not ours and no entry point's."""
    known = (IN_PROCESS, *installed(ExtensionGroup.TRANSPORTS))
    if name not in known and ":" in name:
        raise MasError(
            f"transport '{name}' was given as an object in Python: give it again, or make it an entry point of "
            f"{ExtensionGroup.TRANSPORTS}"
        )
    if name not in known:
        raise MasError(unknown("transport", name, known))


def transport_of(given: TransportLike | str) -> Transport:
    """The transport given, or a new one by its name."""
    if given == IN_PROCESS:
        return InProcessTransport()
    if isinstance(given, str):
        check_transport(given)
        name, extension = given, load_extension(ExtensionGroup.TRANSPORTS, given)
    else:
        name, extension = name_of(given), given
    transport = made(extension)
    if not isinstance(transport, Transport):
        raise MasError(f"transport {name}: a {type(transport).__name__}, not derived from maslam.Transport")
    return transport
