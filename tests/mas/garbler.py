"""An agent whose messages are well formed and say nonsense: one number, flag or byte of some of them is another."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from saboteurs import Saboteur

from maslam.mas.protocol.messages import Message, decode, encode
from maslam.mas.protocol.tensors import MessageError

LIMIT = 2**24


class Garbler(Saboteur):
    """Of every second message one value is changed. ``SEED`` draws which; ``garbled`` counts those that were still
    well formed, and went out."""

    SEED = 0
    garbled = 0
    _rng: np.random.Generator | None = None

    def spoil(self, messages: list[Message]) -> list[Message]:
        if self._rng is None:
            self._rng = np.random.default_rng(self.SEED)
        return [self._garbled(m) if self._rng.random() < 0.5 else m for m in messages]

    def _garbled(self, message: Message) -> Message:
        assert self._rng is not None
        for _ in range(20):
            fields = msgspec.msgpack.decode(encode(message))
            places = list(_leaves(fields[3], [3]))
            path = places[int(self._rng.integers(len(places)))]
            target: Any = fields
            for key in path[:-1]:
                target = target[key]
            target[path[-1]] = self._other(target[path[-1]])
            try:
                changed = decode(msgspec.msgpack.encode(fields), LIMIT)
            except MessageError:
                continue
            self.garbled += changed != message
            return changed
        return message

    def _other(self, value: Any) -> Any:
        assert self._rng is not None
        rng = self._rng
        if isinstance(value, bool):
            return not value
        if isinstance(value, int):
            return int(rng.choice([value + 1, max(value - 1, 0), 0, 1, 7, 10**6]))
        if isinstance(value, float):
            return float(rng.choice([0.0, 1.0, -value, 1e-6, 1e6, value * 3.0, 1e300]))
        if isinstance(value, bytes) and value:
            out = bytearray(value)
            for _ in range(int(rng.integers(1, 4))):
                out[int(rng.integers(len(out)))] = int(rng.integers(256))
            return bytes(out)
        return value if rng.random() < 0.5 else None


def _leaves(value: Any, path: list[int]) -> Any:
    if isinstance(value, list) and value:
        for k, part in enumerate(value):
            yield from _leaves(part, [*path, k])
    else:
        yield path
