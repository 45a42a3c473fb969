"""Relays on this machine between two agents, UDP for QUIC and TCP for TLS, that lose, delay or swallow what passes."""

from __future__ import annotations

import heapq
import selectors
import socket
import threading
import time
from dataclasses import dataclass, field
from itertools import count
from types import TracebackType

import numpy as np

_LARGEST = 65_536
_POLL_S = 0.05


@dataclass
class LinkFaults:
    """``loss``: share of datagrams (UDP only); ``delay_s``: one way; ``cut``: nothing passes, no connection ends."""

    loss: float = 0.0
    delay_s: float = 0.0
    cut: bool = False


@dataclass
class Relay:
    """``with Relay("udp", target_port, faults) as relay``: whoever connects to ``relay.port`` talks to the target.
    ``passed``, ``lost``: datagrams, or pieces of streams; ``passed_bytes``: in them, both ways."""

    protocol: str
    target_port: int
    faults: LinkFaults
    seed: int = 0
    passed: int = 0
    lost: int = 0
    passed_bytes: int = 0
    port: int = field(init=False)

    def __enter__(self) -> Relay:
        kind = socket.SOCK_DGRAM if self.protocol == "udp" else socket.SOCK_STREAM
        self._listener = socket.socket(socket.AF_INET, kind)
        self._listener.bind(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        if self.protocol == "tcp":
            self._listener.listen()
        self._rng = np.random.default_rng(self.seed)
        self._ended = threading.Event()
        self._order = count()
        self._waiting: list[tuple[float, int, socket.socket, bytes, tuple[str, int] | None]] = []
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._listener, selectors.EVENT_READ)
            (self._relay_datagrams if self.protocol == "udp" else self._relay_streams)(selector)
            for key in list(selector.get_map().values()):
                key.fileobj.close()  # type: ignore[union-attr]

    # -- datagrams ----------------------------------------------------------------------------------------------------

    def _relay_datagrams(self, selector: selectors.DefaultSelector) -> None:
        outside: dict[tuple[str, int], socket.socket] = {}
        back: dict[socket.socket, tuple[str, int]] = {}
        while not self._ended.is_set():
            for key, _ in selector.select(self._deliver()):
                one = key.fileobj
                assert isinstance(one, socket.socket)
                try:
                    data, sender = one.recvfrom(_LARGEST)
                except ConnectionError:  # nobody listens behind it now
                    continue
                if one is self._listener and sender not in outside:
                    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                    made.connect(("127.0.0.1", self.target_port))
                    selector.register(made, selectors.EVENT_READ)
                    outside[sender], back[made] = made, sender
                if self.faults.cut or self._rng.random() < self.faults.loss:
                    self.lost += 1
                elif one is self._listener:
                    self._later(outside[sender], data, None)
                else:
                    self._later(self._listener, data, back[one])

    # -- streams ------------------------------------------------------------------------------------------------------

    def _relay_streams(self, selector: selectors.DefaultSelector) -> None:
        other: dict[socket.socket, socket.socket] = {}
        while not self._ended.is_set():
            wait_s = self._deliver()
            if self.faults.cut:
                time.sleep(_POLL_S)
                continue
            for key, _ in selector.select(wait_s):
                one = key.fileobj
                assert isinstance(one, socket.socket)
                if one is self._listener:
                    came, _ = one.accept()
                    try:
                        made = socket.create_connection(("127.0.0.1", self.target_port), 1.0)
                    except OSError:
                        came.close()
                        continue
                    other[came], other[made] = made, came
                    for end in (came, made):
                        selector.register(end, selectors.EVENT_READ)
                    continue
                if one not in other:  # its other end was closed just now
                    continue
                try:
                    data = one.recv(_LARGEST)
                except ConnectionError:
                    data = b""
                if data:
                    self._later(other[one], data, None)
                    continue
                for end in (one, other.pop(one)):
                    other.pop(end, None)
                    if end in selector.get_map():
                        selector.unregister(end)
                    end.close()

    # -- both ---------------------------------------------------------------------------------------------------------

    def _later(self, to: socket.socket, data: bytes, address: tuple[str, int] | None) -> None:
        self.passed += 1
        self.passed_bytes += len(data)
        heapq.heappush(self._waiting, (time.monotonic() + self.faults.delay_s, next(self._order), to, data, address))

    def _deliver(self) -> float:
        """Send what is due; how long nothing else is."""
        while self._waiting and (self._waiting[0][0] <= time.monotonic()) and not self.faults.cut:
            _, _, to, data, address = heapq.heappop(self._waiting)
            try:
                if address is not None:
                    to.sendto(data, address)
                elif self.protocol == "udp":
                    to.send(data)
                else:
                    to.sendall(data)
            except OSError:
                self.lost += 1
        return min(max(self._waiting[0][0] - time.monotonic(), 0.0), _POLL_S) if self._waiting else _POLL_S
