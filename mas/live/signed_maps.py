"""Maps that nobody but their owner can have made, however often they were resold.

An owner signs each version of its map that it sells (ECDSA with the key of its certificate, over all numbers of the
version). Signatures travel in front of the delivery that holds the map, and with them the owner's certificate where
another sells it. Who buys makes the version from the patches, and checks it before its agent sees the delivery. So the
agent, the simulation and their messages know nothing of signatures. Only maps in the compact form are signed: in the
thesis's form each seller moves the map into its own coordinates, and it is another map from then on.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np

from ..agent import Agent
from ..map_exchange.coding.quantised_map import QuantisedMap
from ..map_exchange.versions import version_of
from ..protocol.ids import MAX_AGENTS, AgentId, Index
from ..protocol.map_messages import MapDelivery, Parcel
from ..protocol.messages import Message, Result
from ..protocol.tensors import MessageError
from .credentials import Credentials, CredentialsError

SIGNED = b"\xc1"
"""First byte of a message with signatures in front; no message of the protocol begins with it."""
_SIGNED_MAP = b"maslam map 1"
_LENGTH = struct.Struct("<I")
_MOST_BYTES = 2**20


class MapSignature(msgspec.Struct, frozen=True, array_like=True):
    """``certificate``: the owner's (DER), empty where it sends the map itself."""

    owner: AgentId
    version: Index
    signature: Annotated[bytes, msgspec.Meta(max_length=128)]
    certificate: Annotated[bytes, msgspec.Meta(max_length=8192)] = b""


_Signatures = Annotated[tuple[MapSignature, ...], msgspec.Meta(max_length=MAX_AGENTS)]
_decoder = msgspec.msgpack.Decoder(_Signatures)


@dataclass(frozen=True)
class SignedBytes:
    """A message and the signatures that came in front of it."""

    message: bytes
    signatures: tuple[MapSignature, ...]


def split_signed(data: bytes) -> SignedBytes:
    """The message in ``data``; :class:`MessageError` where signatures in front of it cannot be read."""
    if data[:1] != SIGNED:
        return SignedBytes(data, ())
    try:
        (length,) = _LENGTH.unpack_from(data, 1)
        end = 1 + _LENGTH.size + length
        if length > _MOST_BYTES or end > len(data):
            raise MessageError(f"{length} bytes of signatures in a message of {len(data)}")
        return SignedBytes(data[end:], _decoder.decode(data[1 + _LENGTH.size : end]))
    except (struct.error, msgspec.MsgspecError) as error:
        raise MessageError(f"signatures that cannot be read: {error}") from error


def digest_of_map(made: QuantisedMap) -> bytes:
    """32 bytes that stand for all numbers of a version, its owner and its coordinates among them."""
    steps = made.steps
    head = (
        *(made.owner, made.version, made.frame.agent, made.frame.track),
        *(steps.position, steps.rotation, steps.direction, steps.depth),
    )
    found = hashlib.blake2b(_SIGNED_MAP + struct.pack("<8qd", *head, made.unit), digest_size=32)
    parts = (made.keyframes, made.ticks, made.poses, made.counts, made.cells, made.depths, made.matches)
    described = np.zeros((0, 0), dtype=np.uint8) if made.descriptors is None else made.descriptors
    for part in (*parts, made.transforms, described):
        found.update(struct.pack("<2q", len(part), part.size) + np.ascontiguousarray(part, dtype="<i8").tobytes())
    return found.digest()


class MapSignatures:
    """Signs what ``agent`` sells, checks what it buys. ``kept``: signatures of versions that it bought, which it needs
    to resell them; ``sent_bytes``: of signatures and certificates."""

    def __init__(self, credentials: Credentials, agent: Agent, kept: Iterable[bytes] = ()) -> None:
        self.sent_bytes = 0
        self._credentials = credentials
        self._agent = agent
        self._own: dict[int, MapSignature] = {}
        self._bought: dict[int, dict[int, MapSignature]] = {}
        for data in kept:
            for one in _decoder.decode(data):
                self._keep(one)

    def seal(self, message: Message, data: bytes) -> bytes:
        """The bytes of a message that departs, with the signatures of the maps in it in front."""
        delivery = _delivery_of(message)
        if delivery is None or not delivery.parcels:
            return data
        found = [self._signature_of(p.owner, p.patches[-1].version) for p in delivery.parcels]
        signatures = msgspec.msgpack.encode([one for one in found if one is not None])
        front = SIGNED + _LENGTH.pack(len(signatures)) + signatures
        self.sent_bytes += len(front)
        return front + data

    def check(self, message: Message, signatures: tuple[MapSignature, ...], certificate: bytes) -> bytes:
        """Whether each map in a message was made by its owner; :class:`MessageError` where not. ``certificate``:
        the sender's. Returns what :class:`MapSignatures` needs to be given again after a restart, empty if nothing."""
        delivery = _delivery_of(message)
        by_owner = {one.owner: one for one in signatures}
        kept = []
        for parcel in delivery.parcels if delivery is not None else ():
            made = self._made(parcel)
            if made is None:
                continue  # it makes no map: the agent finds that out, too
            one = by_owner.get(parcel.owner)
            if one is None or one.version != made.version:
                raise MessageError(f"a map of agent {parcel.owner}, version {made.version}, without its signature")
            shown = certificate if parcel.owner == message.sender else one.certificate
            try:
                genuine = self._credentials.signed_by(parcel.owner, shown, one.signature, digest_of_map(made))
            except CredentialsError as error:
                raise MessageError(f"a map of agent {parcel.owner}: {error}") from error
            if not genuine:
                raise MessageError(f"a map of agent {parcel.owner}, version {made.version}, that it did not make")
            kept.append(msgspec.structs.replace(one, certificate=shown))
        for one in kept:
            self._keep(one)
        return msgspec.msgpack.encode(kept) if kept else b""

    def _made(self, parcel: Parcel) -> QuantisedMap | None:
        """The version that a parcel makes of what is here, as the agent will make it; None where it makes none."""
        copy = self._agent.maps.copies.get(parcel.owner)
        try:
            return version_of(parcel.owner, None if copy is None else copy.map_version, parcel.patches).map
        except MessageError:
            return None

    def _signature_of(self, owner: int, version: int) -> MapSignature | None:
        if owner != self._agent.state.me:
            return self._bought.get(owner, {}).get(version)
        if version not in self._own:
            made = self._agent.maps.seller.sold.get(version)
            if made is not None:
                signature = self._credentials.sign(digest_of_map(made))
                self._own[version] = MapSignature(owner, version, signature)
        return self._own.get(version)

    def _keep(self, one: MapSignature) -> None:
        """Of each owner, two versions: the one that is sold, and the one that came just now and may be refused."""
        of_owner = self._bought.setdefault(one.owner, {})
        of_owner.pop(one.version, None)
        of_owner[one.version] = one
        while len(of_owner) > 2:
            del of_owner[next(iter(of_owner))]


def _delivery_of(message: Message) -> MapDelivery | None:
    body = message.body
    return body.outcome if isinstance(body, Result) and isinstance(body.outcome, MapDelivery) else None
