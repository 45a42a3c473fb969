"""Bytes on a link as a relay counts them, with all that TLS, QUIC and Zenoh add: run it as a script.

Joining and idling of two agents, and each hop of a chain of five, beside the frames that crossed it by the agents' own
count (``process.json``). Not part of the tests: it takes minutes.
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path

from relayed_teams import RelayedTeam, say

_IDLE_S, _QUIET_BYTES, _LONGEST_S = 20.0, 200, 60.0
_NAMES = ("message_bytes", "data_bytes", "control_bytes", "greeting_bytes", "frames")


def joining_and_idle(folder: Path, over: str) -> None:
    """Two agents whose drives hardly go on: bytes until the link is quiet, and per second from then on."""
    with RelayedTeam(folder, 2, over) as team:
        for me in range(2):
            team.start(me, 0.001)
        (relay,) = team.relays.values()
        team.until(lambda: relay.passed_bytes > 0, _LONGEST_S, "the agents connect")
        before, began_s = -_QUIET_BYTES, time.monotonic()
        while relay.passed_bytes - before >= _QUIET_BYTES and time.monotonic() - began_s < _LONGEST_S:
            before = relay.passed_bytes
            time.sleep(2.0)
        joined, began_s = relay.passed_bytes, time.monotonic()
        time.sleep(_IDLE_S)
        each_s = (relay.passed_bytes - joined) / (time.monotonic() - began_s)
        say(f"{over}: joining {joined} bytes, idle {each_s:.0f} bytes a second, both ways")


def chain(folder: Path, over: str, count: int = 5) -> None:
    """Agent k reaches only its neighbours: what crosses each hop."""
    with RelayedTeam(folder, count, over, lambda a, b: a - b == 1) as team:
        team.meet(0.1)
        team.end()
        sent = [json.loads((team.out(me) / "process.json").read_text())["sent"] for me in range(count)]
        for (a, b), relay in sorted(team.relays.items()):
            pairs = [(x, y) for x in range(count) for y in range(count) if min(x, y) <= b and max(x, y) >= a]
            crossed = {name: sum(sent[x].get(str(y), {}).get(name, 0) for x, y in pairs) for name in _NAMES}
            messages = crossed["message_bytes"]
            say(
                f"{over}, agents {b} and {a}: {crossed}; data {crossed['data_bytes'] / messages:.3f} x messages, all "
                f"bytes on the link {relay.passed_bytes}, {relay.passed_bytes / messages:.2f} x messages"
            )


def main() -> None:
    for over in ("tls", "quic"):
        for measure in (joining_and_idle, chain):
            with tempfile.TemporaryDirectory(prefix="maslam-links-") as folder:
                measure(Path(folder), over)


if __name__ == "__main__":
    main()
