"""A link over Zenoh (eclipse-zenoh): TCP, TLS or QUIC, over relays where agents do not reach each other directly.

Every agent opens its session as a router, so each passes on what is for others. With a folder of credentials links are
TLS in both directions (mutual): who has no certificate of the team's authority is not connected.
"""

from __future__ import annotations

import json
import logging
import os
import queue
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from ..errors import MasError
from .link import Arrived, Link, Presence

_MOST_BYTES = 8 * 2**20
_LEASE_MS = 4000
_SECURED = ("tls/", "quic/")
_NUMBER = re.compile(r"\d{1,9}")
log = logging.getLogger(__name__)


class LinkError(MasError):
    """An address that cannot be used, or a missing package."""


@dataclass(frozen=True)
class LinkAddresses:
    """``listen``, ``connect``: like ``tls/0.0.0.0:7447``, ``quic/192.168.1.12:7447``, ``tcp/localhost:7447``; with
    ``credentials``, the folder of ``ca.pem``, ``cert.pem`` and ``key.pem``, only tls and quic."""

    listen: Sequence[str] = ()
    connect: Sequence[str] = ()
    credentials: Path | None = None


class ZenohLink(Link):
    """``with ZenohLink(me, team, addresses) as link``: the keys ``TEAM/m/TO/FROM`` are bytes,
    ``TEAM/here/NUMBER/PROCESS`` says that a process of an agent is there, ``TEAM/TOPIC/NUMBER`` are an agent's topics;
    all below ``maslam/``."""

    def __init__(self, me: int, team: str, addresses: LinkAddresses) -> None:
        self.me = me
        self._root = root_of(team)
        self._addresses = addresses
        self._arrivals: queue.SimpleQueue[Arrived | Presence] = queue.SimpleQueue()
        self._session: Any = None
        self._kept: list[Any] = []
        self._publishers: dict[str, Any] = {}

    def __enter__(self) -> ZenohLink:
        self._session = open_session(self._addresses)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for one in reversed([*self._kept, *self._publishers.values()]):
            one.undeclare()
        close_session(self._session)

    def appear(self, process: str) -> None:
        here, session = f"{self._root}/here", self._session
        # Callbacks run in the library's threads: they only put what came where the agent takes it.
        self._kept = [
            session.declare_subscriber(f"{self._root}/m/{self.me}/*", self._came),
            session.liveliness().declare_token(f"{here}/{self.me}/{process}"),
            session.liveliness().declare_subscriber(f"{here}/*/*", self._changed, history=True),
        ]

    def send(self, other: int, data: bytes) -> None:
        self._session.put(f"{self._root}/m/{other}/{self.me}", data)

    def publish(self, topic: str, data: bytes) -> None:
        self._publisher(topic).put(data)

    def listened_to(self, topic: str) -> bool:
        return bool(self._publisher(topic).matching_status)

    def _publisher(self, topic: str) -> Any:
        if topic not in self._publishers:
            self._publishers[topic] = self._session.declare_publisher(f"{self._root}/{topic}/{self.me}")
        return self._publishers[topic]

    def receive(self, wait_s: float) -> Arrived | Presence | None:
        try:
            return self._arrivals.get(timeout=wait_s) if wait_s > 0 else self._arrivals.get_nowait()
        except queue.Empty:
            return None

    @property
    def connected(self) -> bool:
        return bool(self._session.info.routers_zid() or self._session.info.peers_zid())

    def _came(self, sample: Any) -> None:
        sender = number_of(str(sample.key_expr))
        if sender is not None:
            self._arrivals.put(Arrived(sender, sample.payload.to_bytes()))

    def _changed(self, sample: Any) -> None:
        key, _, process = str(sample.key_expr).rpartition("/")
        other = number_of(key)
        if other is not None:
            self._arrivals.put(Presence(other, "PUT" in str(sample.kind), process))


@contextmanager
def _quiet() -> Iterator[None]:
    """Nothing on standard error: where two sessions close at once, a thread of Zenoh (1.10.2) ends with a stack trace
    after its work."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def root_of(team: str) -> str:
    """What all keys of a team begin with."""
    return "maslam/" + re.sub(r"[^A-Za-z0-9_.-]", "_", team)


def open_session(addresses: LinkAddresses) -> Any:
    """A session as a router; :class:`LinkError` where an address cannot be used."""
    try:
        import zenoh
    except ImportError as error:
        raise LinkError("agents on a network need the extra 'network': pip install 'maslam[network]'") from error
    try:
        return zenoh.open(_settings(zenoh, addresses))
    except zenoh.ZError as error:
        raise LinkError(_in_words(str(error), addresses)) from error


def close_session(session: Any) -> None:
    """Close a session, without a word."""
    import zenoh

    with _quiet():
        try:
            session.close()
        except zenoh.ZError as error:  # nothing is left to send
            log.info("the link did not close in time: %s", error)


def number_of(key: str) -> int | None:
    """The agent's number at the end of a key, None where there is none."""
    last = key.rpartition("/")[2]
    return int(last) if _NUMBER.fullmatch(last) else None


def _settings(zenoh: Any, addresses: LinkAddresses) -> Any:
    """The session's settings; values are JSON."""
    config = zenoh.Config()
    values: dict[str, Any] = {
        "mode": "router",
        "listen/endpoints": list(addresses.listen),
        "connect/endpoints": list(addresses.connect),
        "connect/timeout_ms": -1,  # tried again for ever, while the session is open: the other may start later
        "connect/exit_on_failure": False,
        "scouting/multicast/enabled": False,
        "scouting/gossip/autoconnect": {"router": [], "peer": []},
        "timestamping/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": _MOST_BYTES,
        "transport/link/tx/lease": _LEASE_MS,
    }
    if addresses.credentials is not None:
        folder = addresses.credentials
        open_ones = [a for a in (*addresses.listen, *addresses.connect) if not a.startswith(_SECURED)]
        if open_ones:
            raise LinkError(f"{open_ones[0]}: with certificates addresses begin with tls/ or quic/")
        for end in ("listen", "connect"):
            values[f"transport/link/tls/{end}_certificate"] = str(folder / "cert.pem")
            values[f"transport/link/tls/{end}_private_key"] = str(folder / "key.pem")
        values["transport/link/tls/root_ca_certificate"] = str(folder / "ca.pem")
        values["transport/link/tls/enable_mtls"] = True
        values["transport/link/tls/verify_name_on_connect"] = False  # robots change addresses
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _in_words(error: str, addresses: LinkAddresses) -> str:
    listen = ", ".join(addresses.listen)
    if "in use" in error.lower() or "os error 98" in error.lower():
        return f"{listen}: another process listens there already"
    if "os error 99" in error.lower():
        return f"{listen}: this machine has no such address"
    return f"{listen or ', '.join(addresses.connect)}: {error.splitlines()[0][:300]}"
