"""A team's authority: it signs the certificate of each agent, on a machine that stays at home."""

from __future__ import annotations

import datetime as dt
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from maslam._atomic import write_atomically

from .credentials import (
    AUTHORITY,
    CERTIFICATE,
    INSTALL,
    KEY,
    CredentialsError,
    certificate_of,
    name_of_agent,
    read_file,
)
from .revocation import REVOKED, RevokedList, read_list

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.x509 import BasicConstraints, Certificate, Name

AUTHORITY_FOLDER = "authority"
_DAYS = 3650
# Robots' clocks may be behind.
_BEFORE = dt.timedelta(days=365)


def make_team(folder: Path, team: str, agents: Sequence[int]) -> list[Path]:
    """Certificates in ``folder``: the authority's in ``authority/`` (that folder goes on no robot), each agent's in
    ``agent_NN/``, valid for ten years. Where the authority is there already, agents are added to its team. Returns the
    agents' folders; :class:`~.credentials.CredentialsError` where one exists, or the authority is another team's.
    """
    try:
        from cryptography import x509
    except ImportError as error:
        raise CredentialsError(INSTALL) from error
    for agent in agents:
        if (folder / name_of_agent(agent)).exists():
            raise CredentialsError(f"{folder / name_of_agent(agent)}: exists; its certificate is kept as it is")
    own = folder / AUTHORITY_FOLDER
    if not (own / KEY).exists():
        key, name = _new_key(), _subject("authority", team)
        made = _signed(name, name, key, key, x509.BasicConstraints(ca=True, path_length=0))
        _write(own, key, made, made)
    authority, signer = _authority_of(own)
    of_team = _team_of(authority)
    if of_team != team:
        raise CredentialsError(f"{own}: the authority of team {of_team!r}, not {team!r}")
    return [_add_agent(folder, authority, signer, agent) for agent in agents]


def revoke(folder: Path, agent: int) -> list[Path]:
    """Take back the certificate of an agent of the team in ``folder``: the list in ``authority/`` gets its number, and
    so do those in the agents' folders that are still there. Returns the files written."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization

    own, name = folder / AUTHORITY_FOLDER, name_of_agent(agent)
    authority, key = _authority_of(own)
    kept = own / f"{name}.pem"
    certificate = certificate_of(kept if kept.exists() else folder / name / CERTIFICATE)
    before = read_list(read_file(own / REVOKED), authority) if (own / REVOKED).exists() else RevokedList()
    if certificate.serial_number in before.serials:
        raise CredentialsError(f"{own / REVOKED}: the certificate of {name} was revoked already")
    now = dt.datetime.now(dt.UTC)
    builder = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(authority.subject)
        .last_update(now - _BEFORE)
        .next_update(now + dt.timedelta(days=_DAYS))
        .add_extension(x509.CRLNumber(before.number + 1), critical=False)
    )
    for serial in sorted({*before.serials, certificate.serial_number}):
        one = x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(now).build()
        builder = builder.add_revoked_certificate(one)
    text = builder.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
    places = [own, *sorted(p for p in folder.glob("agent_*") if (p / CERTIFICATE).is_file())]
    for place in places:
        write_atomically(place / REVOKED, text)  # a running agent reads it whole or not at all
    return [place / REVOKED for place in places]


def _authority_of(own: Path) -> tuple[Certificate, EllipticCurvePrivateKey]:
    """The authority's certificate and key."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    try:
        key = serialization.load_pem_private_key(read_file(own / KEY), None)
    except (ValueError, TypeError) as error:
        raise CredentialsError(f"{own / KEY}: no key (PEM, without a password): damaged?") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise CredentialsError(f"{own / KEY}: a key of another kind than `maslam keys` makes")
    return certificate_of(own / CERTIFICATE), key


def _add_agent(folder: Path, authority: Certificate, signer: EllipticCurvePrivateKey, agent: int) -> Path:
    from cryptography import x509
    from cryptography.hazmat.primitives import serialization

    key, place, own = _new_key(), folder / name_of_agent(agent), folder / AUTHORITY_FOLDER
    subject = _subject(name_of_agent(agent), _team_of(authority))
    certificate = _signed(subject, authority.subject, key, signer, x509.BasicConstraints(ca=False, path_length=None))
    _write(place, key, certificate, authority)
    # What is revoked later is known by its certificate.
    (own / f"{place.name}.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    if (own / REVOKED).exists():
        (place / REVOKED).write_bytes((own / REVOKED).read_bytes())
    return place


def _new_key() -> EllipticCurvePrivateKey:
    from cryptography.hazmat.primitives.asymmetric import ec

    return ec.generate_private_key(ec.SECP256R1())


def _subject(name: str, team: str) -> Name:
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    named = [(NameOID.COMMON_NAME, name), (NameOID.ORGANIZATION_NAME, team)]
    return x509.Name([x509.NameAttribute(oid, value) for oid, value in named])


def _team_of(certificate: Certificate) -> str:
    from cryptography.x509.oid import NameOID

    return str(certificate.subject.get_attributes_for_oid(NameOID.ORGANIZATION_NAME)[0].value)


def _signed(
    subject: Name,
    issuer: Name,
    key: EllipticCurvePrivateKey,
    signer: EllipticCurvePrivateKey,
    basic: BasicConstraints,
) -> Certificate:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes

    now = dt.datetime.now(dt.UTC)
    name = str(subject.rdns[0].rfc4514_string().partition("=")[2])
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _BEFORE)
        .not_valid_after(now + dt.timedelta(days=_DAYS))
        .add_extension(basic, critical=True)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(name.replace("_", "-"))]), critical=False)
    )
    return builder.sign(signer, hashes.SHA256())


def _write(folder: Path, key: EllipticCurvePrivateKey, certificate: Certificate, authority: Certificate) -> None:
    from cryptography.hazmat.primitives import serialization

    encoding = serialization.Encoding.PEM
    secret = key.private_bytes(encoding, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    for name, text in (
        (AUTHORITY, authority.public_bytes(encoding)),
        (CERTIFICATE, certificate.public_bytes(encoding)),
    ):
        (folder / name).write_bytes(text)
    # The key last, and for its owner alone.
    with os.fdopen(os.open(folder / KEY, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(secret)
