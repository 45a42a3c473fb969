"""A team's authority: it signs the certificate of each agent, on a machine that stays at home."""

from __future__ import annotations

import datetime as dt
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .credentials import AUTHORITY, CERTIFICATE, INSTALL, KEY, CredentialsError, name_of_agent, read_file

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
    try:
        authority = x509.load_pem_x509_certificate(read_file(own / CERTIFICATE))
    except ValueError as error:
        raise CredentialsError(f"{own / CERTIFICATE}: no certificate (PEM): damaged?") from error
    of_team = _team_of(authority)
    if of_team != team:
        raise CredentialsError(f"{own}: the authority of team {of_team!r}, not {team!r}")
    return [_add_agent(folder, own, authority, agent) for agent in agents]


def _add_agent(folder: Path, own: Path, authority: Certificate, agent: int) -> Path:
    from cryptography import x509
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key = _new_key()
    try:
        signer = serialization.load_pem_private_key(read_file(own / KEY), None)
    except (ValueError, TypeError) as error:
        raise CredentialsError(f"{own / KEY}: no key (PEM, without a password): damaged?") from error
    if not isinstance(signer, ec.EllipticCurvePrivateKey):
        raise CredentialsError(f"{own / KEY}: a key of another kind than `maslam keys` makes")
    subject = _subject(name_of_agent(agent), _team_of(authority))
    certificate = _signed(subject, authority.subject, key, signer, x509.BasicConstraints(ca=False, path_length=None))
    _write(folder / name_of_agent(agent), key, certificate, authority)
    return folder / name_of_agent(agent)


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
