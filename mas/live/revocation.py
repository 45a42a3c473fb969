"""Certificates that the team's authority has taken back: a signed list (X.509 CRL) that agents load and pass on.

Lists are numbered; a newer one takes the place of an older one, whoever brings it: only the authority can sign one.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import MasError

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

REVOKED = "revoked.pem"
"""File of an agent's folder; may be put there while the agent runs."""
_LOOK_NS = 1_000_000_000
_MOST_BYTES = 64 * 1024
log = logging.getLogger(__name__)


class UnsignedListError(MasError):
    """A list that the team's authority did not sign."""


class RevokedError(MasError):
    """This agent's own certificate was taken back."""


@dataclass(frozen=True)
class RevokedList:
    """``number`` grows with each list of a team; ``der``: as it is passed on; ``serials``: of certificates."""

    number: int = 0
    der: bytes = b""
    serials: frozenset[int] = frozenset()


def read_list(data: bytes, authority: Certificate) -> RevokedList:
    """The list in PEM or DER; :class:`UnsignedListError` where the authority did not sign it."""
    from cryptography import x509
    from cryptography.hazmat.primitives import serialization

    if len(data) > _MOST_BYTES:
        raise UnsignedListError(f"a list of {len(data)} bytes")
    load = x509.load_pem_x509_crl if data[:1] == b"-" else x509.load_der_x509_crl
    try:
        found = load(data)
        signed = found.is_signature_valid(authority.public_key())  # type: ignore[arg-type]
        number = found.extensions.get_extension_for_class(x509.CRLNumber).value.crl_number
        serials = frozenset(one.serial_number for one in found)
    except (ValueError, TypeError, x509.ExtensionNotFound) as error:
        log.info("list of revoked certificates: %s", error)
        raise UnsignedListError("no list of revoked certificates that `maslam keys` made") from error
    if not signed or not 0 < number < 2**32:
        raise UnsignedListError("a list of revoked certificates that the team's authority did not sign")
    return RevokedList(number, found.public_bytes(serialization.Encoding.DER), serials)


class Revocations:
    """The newest list that one agent knows. ``serial``: of its own certificate."""

    def __init__(self, folder: Path, authority: Certificate, serial: int) -> None:
        self.newest = RevokedList()
        self._path = folder / REVOKED
        self._authority = authority
        self._serial = serial
        self._looked_ns: int | None = None
        self._stamp = 0
        if self._path.exists():
            self._load()

    def refresh(self) -> bool:
        """Look for a newer file, at most once a second; whether there is a newer list."""
        now_ns = time.monotonic_ns()
        if self._looked_ns is not None and now_ns - self._looked_ns < _LOOK_NS:
            return False
        self._looked_ns = now_ns
        try:
            return self._path.stat().st_mtime_ns != self._stamp and self._load()
        except FileNotFoundError:
            return False
        except UnsignedListError as error:
            log.warning("%s", error)
            return False

    def take(self, der: bytes) -> bool:
        """A list that another agent passes on; whether it is newer than mine. :class:`UnsignedListError` where the
        authority did not sign it, :class:`RevokedError` where it names this agent."""
        found = read_list(der, self._authority)
        if found.number <= self.newest.number:
            return False
        self.newest = found
        if self._serial in found.serials:
            raise RevokedError("this agent's certificate was revoked by its team's authority")
        log.warning("list %d of revoked certificates: %d of them", found.number, len(found.serials))
        return True

    def _load(self) -> bool:
        self._stamp = self._path.stat().st_mtime_ns
        try:
            return self.take(self._path.read_bytes())
        except UnsignedListError as error:
            raise UnsignedListError(f"{self._path}: {error}") from error
