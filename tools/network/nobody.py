"""An agent that nobody answers says why, once and within seconds."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

_NOBODY_S = 2.0


class NobodyThere:
    """``check`` at each step of an agent. ``connect``: where it looks for others; ``credentials``: its folder;
    ``connected``: whether anybody is, whoever it is."""

    def __init__(self, connect: Sequence[str], credentials: Path, connected: Callable[[], bool]) -> None:
        self._connect = connect
        self._credentials = credentials
        self._connected = connected
        self._began = time.monotonic()
        self._reasons: list[str] | None = None
        self._looks = self._said = False

    def check(self, neighbours: int, refused: bool) -> str | None:
        """What is wrong, once; None while it is not known, or nothing is. ``neighbours``: other agents that are there;
        ``refused``: one is there and not talked to, which is said elsewhere."""
        if self._said or neighbours or refused or time.monotonic() - self._began < _NOBODY_S:
            return None
        if self._connected():
            self._said = True
            return "connected, but no agent of this team is there"
        if not self._looks:
            self._looks = True
            threading.Thread(target=self._look, daemon=True).start()
        if self._reasons is None:
            return None
        self._said = True
        why = "; ".join(self._reasons) or "nobody has connected yet" + (
            " (no address to connect to was given)" if not self._connect else ""
        )
        return f"nobody is connected: {why}"

    def _look(self) -> None:
        from maslam.mas.transport.reachability import reasons

        self._reasons = reasons(self._connect, self._credentials)
