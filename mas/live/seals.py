"""Codes that protect the frames between two agents, and the keys that they are made with."""

from __future__ import annotations

import hashlib
import hmac
import struct

from ..errors import MasError

_SEAL = struct.Struct("<I8s")
SEAL_BYTES = _SEAL.size
# Frames may overtake each other by so many.
_WINDOW = 1024
_LAST = 2**32


class SealError(MasError):
    """A key that is none, or one that has protected all the frames that it may."""


class SessionKey:
    """The key of one process of an agent: made when it starts, never written down."""

    def __init__(self) -> None:
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

        self._private = X25519PrivateKey.generate()
        self.public = self._private.public_key().public_bytes_raw()

    def seals(self, me: int, other: int, public: bytes) -> Seals:
        """What protects the frames between me and another, whose public key of its session is given."""
        return self._of(public, struct.pack("<II", me, other), struct.pack("<II", other, me))

    def seals_of_twin(self, public: bytes) -> Seals:
        """The same between two processes of one agent."""
        return self._of(public, self.public, public)

    def _of(self, public: bytes, out: bytes, into: bytes) -> Seals:
        """``out``, ``into``: what tells the two directions apart."""
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PublicKey

        try:
            shared = self._private.exchange(X25519PublicKey.from_public_bytes(public))
        except ValueError as error:
            raise SealError(f"no public key: {error}") from error
        both = b"".join(sorted((self.public, public)))
        out_key, into_key = (hashlib.blake2b(both + ends, key=shared, digest_size=32).digest() for ends in (out, into))
        return Seals(out_key, into_key)


class Seals:
    """The codes of frames in both directions; each frame is taken once."""

    def __init__(self, out: bytes, into: bytes) -> None:
        self._out, self._into = out, into
        self._next = 0
        self._newest = -1
        self._seen = 0

    def seal(self, frame: bytes) -> bytes:
        """The frame with its number and code in front."""
        number, self._next = self._next, self._next + 1
        if number >= _LAST:
            raise SealError("more than 2^32 frames in one session: start the agent anew")
        return _SEAL.pack(number, _code(self._out, number, frame)) + frame

    def open(self, data: bytes) -> bytes | None:
        """The frame, None where it was not sealed by the other agent for me, or came before."""
        if len(data) < SEAL_BYTES:
            return None
        number, code = _SEAL.unpack_from(data)
        frame = data[SEAL_BYTES:]
        if not hmac.compare_digest(code, _code(self._into, number, frame)):
            return None
        behind = self._newest - number
        if behind >= _WINDOW or (behind >= 0 and self._seen >> behind & 1):
            return None
        if behind < 0:
            self._seen = (self._seen << -behind if -behind < _WINDOW else 0) | 1
            self._seen &= (1 << _WINDOW) - 1
            self._newest = number
        else:
            self._seen |= 1 << behind
        return frame


def _code(key: bytes, number: int, frame: bytes) -> bytes:
    return hashlib.blake2b(struct.pack("<I", number) + frame, key=key, digest_size=8).digest()
