"""Why nobody answers at an address: Zenoh tries again for ever, and does not say."""

from __future__ import annotations

import contextlib
import logging
import queue
import socket
import ssl
import threading
import time
from collections.abc import Sequence
from pathlib import Path

_WAIT_S = 1.0
_REFUSED = "it refuses this agent's certificate: of another authority, or its clock is wrong"
_SILENT = "no answer: not started yet, an address or firewall in the way"
log = logging.getLogger(__name__)


def reasons(addresses: Sequence[str], credentials: Path, wait_s: float = 2.0) -> list[str]:
    """For each address that another agent is to listen at a line why it cannot be reached; none for one that answers.
    All are tried at once, for at most ``wait_s`` seconds."""
    found: queue.SimpleQueue[tuple[int, str]] = queue.SimpleQueue()

    def look(number: int, address: str) -> None:
        found.put((number, _reason(address, credentials)))

    for number, address in enumerate(addresses):
        threading.Thread(target=look, args=(number, address), daemon=True).start()
    why = dict.fromkeys(range(len(addresses)), _SILENT)
    until = time.monotonic() + wait_s
    with contextlib.suppress(queue.Empty):
        for _ in addresses:
            number, reason = found.get(timeout=max(until - time.monotonic(), 0.0))
            why[number] = reason
    return [f"{addresses[number]}: {reason}" for number, reason in why.items() if reason]


def _reason(address: str, credentials: Path) -> str:
    """Why there is no link to an address; empty where it answers."""
    protocol, _, where = address.partition("/")
    host, _, port = where.partition("#")[0].partition("?")[0].rpartition(":")
    if not host or not port.isascii() or not port.isdigit():
        return "not an address like tls/192.168.1.10:7447"
    place = host.strip("[]"), int(port)
    try:
        return _over_udp(place) if protocol == "quic" else _over_tcp(place, credentials, secured=protocol == "tls")
    except ConnectionRefusedError:
        return "nobody listens there (yet)"
    except socket.gaierror:
        return f"there is no host {place[0]}"
    except ssl.SSLCertVerificationError as error:
        log.info("%s: %s", address, error)
        expired = "expired" in error.verify_message or "not yet valid" in error.verify_message
        return (
            "its certificate has expired, by this machine's clock"
            if expired
            else "its certificate is of another authority"
        )
    except ssl.SSLError as error:
        log.info("%s: %s", address, error)
        return _REFUSED if "ALERT" in str(error.reason) else "it does not speak TLS"
    except TimeoutError:
        return _SILENT
    except (OSError, OverflowError) as error:
        return str(getattr(error, "strerror", None) or error).lower()


def _over_tcp(place: tuple[str, int], credentials: Path, secured: bool) -> str:
    with socket.create_connection(place, _WAIT_S) as plain:
        if not secured:
            return ""
        context = ssl.create_default_context(cafile=str(credentials / "ca.pem"))
        context.check_hostname = False
        context.load_cert_chain(str(credentials / "cert.pem"), str(credentials / "key.pem"))
        with context.wrap_socket(plain) as wrapped:
            # The other side judges this agent's certificate after its own part of the handshake.
            wrapped.settimeout(_WAIT_S / 2)
            with contextlib.suppress(TimeoutError):
                wrapped.recv(1)
    return ""


def _over_udp(place: tuple[str, int]) -> str:
    """QUIC is not spoken here: only whether nobody listens can be found out."""
    kind = socket.AF_INET6 if ":" in place[0] else socket.AF_INET
    with socket.socket(kind, socket.SOCK_DGRAM) as one:
        one.settimeout(_WAIT_S / 2)
        one.connect(place)
        one.send(b"\0")
        with contextlib.suppress(TimeoutError):
            one.recv(1)
    return "no answer: an address or firewall in the way, or a certificate of another authority"
