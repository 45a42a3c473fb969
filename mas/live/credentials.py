"""Names that cannot be taken by others: certificates of one authority, made before the robots drive.

Each agent has a certificate with its name, ``agent_03``, and the team's, signed by the team's authority, whose key is
on no robot. Two agents that meet show them (:class:`Greeting`) and agree on a key that only they have (X25519, RFC
7748). From then on each frame between them carries a code (keyed BLAKE2b, 8 bytes, RFC 7693) that nobody else can
make, over any number of relays. Frames are not encrypted end to end: on the links they are (TLS), relays can read them.
"""

from __future__ import annotations

import datetime as dt
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from ..errors import MasError
from ..protocol.ids import MAX_AGENTS
from ..protocol.messages import VERSION
from .revocation import Revocations
from .seals import SessionKey

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

AUTHORITY, CERTIFICATE, KEY = "ca.pem", "cert.pem", "key.pem"
"""Files of an agent's folder."""
_SIGNED = b"maslam greeting 1"
_SIGNED_DATA = b"maslam signed 1"
_MOST_BYTES = 8192
_MADE = "that `maslam keys` made: damaged, or of something else"
INSTALL = "agents on a network need the extra 'network': pip install 'maslam[network]'"

log = logging.getLogger(__name__)


class CredentialsError(MasError):
    """Certificates that are missing, of another team, or another's."""


class RevokedCertificateError(CredentialsError):
    """Another agent's certificate that the authority has taken back."""


class Greeting(msgspec.Struct, frozen=True, array_like=True):
    """What an agent shows when it meets another: its certificate (DER), a public key made for this session, the
    signature that binds both; its version of the protocol, and the code of its descriptor model and place code."""

    certificate: bytes
    public: bytes
    signature: bytes
    version: int
    language: int


@dataclass(frozen=True)
class Stranger:
    """Another agent, known by its certificate."""

    number: int
    public: bytes
    version: int
    language: int
    serial: int
    certificate: bytes


def name_of_agent(number: int) -> str:
    """The name in a certificate."""
    return f"agent_{number:02d}"


class Credentials:
    """The certificate of one agent, read from the folder that ``maslam keys`` made for it: ``ca.pem``, ``cert.pem``,
    ``key.pem``, and ``revoked.pem`` where there is one. ``number``, ``team``: who it says that the agent is."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            from cryptography.exceptions import UnsupportedAlgorithm
            from cryptography.hazmat.primitives import serialization
        except ImportError as error:
            raise CredentialsError(INSTALL) from error
        self._authority = certificate_of(folder / AUTHORITY)
        self._certificate = certificate_of(folder / CERTIFICATE)
        key = read_file(folder / KEY)
        try:
            self._key = serialization.load_pem_private_key(key, None)
        except (ValueError, TypeError, UnsupportedAlgorithm) as error:
            log.info("%s: %s", folder / KEY, error)
            raise CredentialsError(f"{folder / KEY}: no key (PEM, without a password) {_MADE}") from error
        self._check_own(folder)
        self.revocations = Revocations(folder, self._authority, self._certificate.serial_number)
        self.number, self.team = self._names(self._certificate, "its own certificate")

    def _check_own(self, folder: Path) -> None:
        """The files belong together, and are valid now."""
        from cryptography.hazmat.primitives.asymmetric import ec

        own, of_key = self._certificate.public_key(), self._key.public_key()
        if not isinstance(self._key, ec.EllipticCurvePrivateKey) or own != of_key:
            raise CredentialsError(f"{folder / KEY}: not the key of {folder / CERTIFICATE}")
        if not issued_by(self._certificate, self._authority):
            raise CredentialsError(
                f"{folder / CERTIFICATE}: not signed by the authority in {folder / AUTHORITY}: of another team, "
                "or made anew?"
            )
        for name, certificate in ((AUTHORITY, self._authority), (CERTIFICATE, self._certificate)):
            wrong = _not_now(certificate)
            if wrong:
                raise CredentialsError(f"{folder / name}: the certificate {wrong}")

    def greeting(self, session: SessionKey, language: int) -> bytes:
        """What to show to another agent."""
        from cryptography.hazmat.primitives import hashes
        from cryptography.hazmat.primitives.asymmetric import ec

        assert isinstance(self._key, ec.EllipticCurvePrivateKey)
        certificate = self.certificate
        signature = self._key.sign(_SIGNED + session.public, ec.ECDSA(hashes.SHA256()))
        return msgspec.msgpack.encode(Greeting(certificate, session.public, signature, VERSION, language))

    def check(self, data: bytes) -> Stranger:
        """Who another agent is by its greeting; :class:`CredentialsError` where it cannot be believed."""
        from cryptography import x509
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives import hashes
        from cryptography.hazmat.primitives.asymmetric import ec

        if len(data) > _MOST_BYTES:
            raise CredentialsError(f"a greeting of {len(data)} bytes")
        try:
            greeting = msgspec.msgpack.decode(data, type=Greeting)
            certificate = x509.load_der_x509_certificate(greeting.certificate)
            key = certificate.public_key()
            if not issued_by(certificate, self._authority):
                raise CredentialsError("a certificate of another authority")
            if not isinstance(key, ec.EllipticCurvePublicKey):
                raise CredentialsError("a certificate with a key of another kind")
            key.verify(greeting.signature, _SIGNED + greeting.public, ec.ECDSA(hashes.SHA256()))
        except InvalidSignature as error:
            raise CredentialsError("a signature that is not its own") from error
        except (msgspec.MsgspecError, ValueError, TypeError) as error:
            log.info("greeting: %s", error)
            raise CredentialsError("a greeting that cannot be read: of another version of maslam?") from error
        self._check_now(certificate)
        number, team = self._names(certificate, "a certificate")
        if team != self.team:
            raise CredentialsError(f"agent {number} is of team {team!r}, not {self.team!r}")
        return Stranger(
            number,
            greeting.public,
            greeting.version,
            greeting.language,
            certificate.serial_number,
            greeting.certificate,
        )

    @property
    def certificate(self) -> bytes:
        """The agent's own (DER)."""
        from cryptography.hazmat.primitives import serialization

        return self._certificate.public_bytes(serialization.Encoding.DER)

    def check_valid(self, certificate: bytes) -> None:
        """:class:`CredentialsError` where a certificate (DER) was revoked or is not valid now."""
        from cryptography import x509

        try:
            shown = x509.load_der_x509_certificate(certificate)
        except (ValueError, TypeError) as error:
            raise CredentialsError("a certificate that cannot be read") from error
        self._check_now(shown)

    def _check_now(self, certificate: Certificate) -> None:
        if certificate.serial_number in self.revocations.newest.serials:
            raise RevokedCertificateError("its certificate was revoked")
        wrong = _not_now(certificate)
        if wrong:
            raise CredentialsError(f"its certificate {wrong}")

    def sign(self, digest: bytes) -> bytes:
        """This agent's signature, in its own name."""
        from cryptography.hazmat.primitives import hashes
        from cryptography.hazmat.primitives.asymmetric import ec

        assert isinstance(self._key, ec.EllipticCurvePrivateKey)
        return self._key.sign(_SIGNED_DATA + digest, ec.ECDSA(hashes.SHA256()))

    def signed_by(self, agent: int, certificate: bytes, signature: bytes, digest: bytes) -> bool:
        """Whether an agent signed this, by its certificate (DER); :class:`CredentialsError` where that is not one of
        this agent. One that has expired or was revoked since still says who signed."""
        from cryptography import x509
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives import hashes
        from cryptography.hazmat.primitives.asymmetric import ec

        try:
            shown = x509.load_der_x509_certificate(certificate)
            key = shown.public_key()
        except (ValueError, TypeError) as error:
            raise CredentialsError("a certificate that cannot be read") from error
        if not issued_by(shown, self._authority) or not isinstance(key, ec.EllipticCurvePublicKey):
            raise CredentialsError("a certificate of another authority")
        if self._names(shown, "a certificate") != (agent, self.team):
            raise CredentialsError("the certificate of another agent")
        try:
            key.verify(signature, _SIGNED_DATA + digest, ec.ECDSA(hashes.SHA256()))
        except InvalidSignature:
            return False
        return True

    def _names(self, certificate: Certificate, what: str) -> tuple[int, str]:
        from cryptography.x509.oid import NameOID

        names = [
            str(attribute.value)
            for oid in (NameOID.COMMON_NAME, NameOID.ORGANIZATION_NAME)
            for attribute in certificate.subject.get_attributes_for_oid(oid)[:1]
        ]
        digits = names[0].removeprefix("agent_") if len(names) == 2 else ""
        if not digits.isascii() or not digits.isdigit() or int(digits[:9]) >= MAX_AGENTS:
            raise CredentialsError(f"{self.folder}: {what} names no agent of a team: {', '.join(names) or 'nobody'}")
        return int(digits[:9]), names[1]


def issued_by(certificate: Certificate, authority: Certificate) -> bool:
    """Whether this authority signed the certificate."""
    from cryptography.exceptions import InvalidSignature

    try:
        certificate.verify_directly_issued_by(authority)
    except (InvalidSignature, ValueError, TypeError):
        return False
    return True


def certificate_of(path: Path) -> Certificate:
    """The certificate in a file; :class:`CredentialsError` where there is none."""
    from cryptography import x509

    data = read_file(path)
    try:
        return x509.load_pem_x509_certificate(data)
    except ValueError as error:
        log.info("%s: %s", path, error)
        raise CredentialsError(f"{path}: no certificate (PEM) {_MADE}") from error


def _not_now(certificate: Certificate) -> str:
    """Why a certificate is not valid now, empty where it is."""
    now = dt.datetime.now(dt.UTC)
    if now > certificate.not_valid_after_utc:
        return f"expired on {certificate.not_valid_after_utc:%Y-%m-%d}, by this machine's clock"
    if now < certificate.not_valid_before_utc:
        return (
            f"is valid from {certificate.not_valid_before_utc:%Y-%m-%d} on; this machine's clock shows {now:%Y-%m-%d}"
        )
    return ""


def read_file(path: Path) -> bytes:
    """A file of a team's; :class:`CredentialsError` where it is missing or cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise CredentialsError(f"{path}: missing; `maslam keys` makes the certificates of a team") from error
    except OSError as error:
        raise CredentialsError(f"{path}: {error.strerror or error}") from error
