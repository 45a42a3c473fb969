"""Processes of all agents of a team on this machine: started, watched, started again where one was killed."""

from __future__ import annotations

import json
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import ToolError
from ..common.progress import Progress

if TYPE_CHECKING:
    from maslam.mas.live.config import LiveConfig

_RESTARTS = 3
_GRACE_S = 5.0
_POLL_S = 0.2


@dataclass(frozen=True)
class AgentCommand:
    """What an agent's process is started with. ``over``: tls or quic; ``more``: of its command line."""

    number: int
    sequences: Path
    out: Path
    credentials: Path
    settings: Path
    live: LiveConfig
    over: str
    more: tuple[str, ...] = ()

    def arguments(self, ports: Sequence[int]) -> list[str]:
        """Its command line; it listens on its own port, and connects to those of lower numbers."""
        mine = f"{self.over}/127.0.0.1:{ports[self.number]}"
        others = [f"{self.over}/127.0.0.1:{port}" for port in ports[: self.number]]
        connect = [word for other in others for word in ("--connect", other)]
        return [
            *(sys.executable, "-m", "maslam", "agent", str(self.sequences), str(self.out)),
            *("--credentials", str(self.credentials), "--config", str(self.settings), "--json"),
            *("--link", self.live.link, "--speed", str(self.live.speed), "--listen", mine, *connect),
            *self.more,
        ]


@dataclass
class _Child:
    """An agent's process; ``readers`` put what it prints where it is looked at."""

    process: subprocess.Popen[str]
    readers: list[threading.Thread]
    restarts: int = 0
    last_line: str = ""
    cpu_s: float = 0.0


@dataclass(frozen=True)
class _Line:
    agent: int
    text: str
    is_error: bool


@dataclass
class _Seen:
    """How far each agent is: the number of this name in its lines, at most its total."""

    name: str
    totals: Sequence[int]
    done: list[int]

    def note(self, agent: int, step: dict[str, Any]) -> None:
        self.done[agent] = min(int(step[self.name]), self.totals[agent])


def run_together(
    commands: Sequence[AgentCommand], counted: str, totals: Sequence[int], progress: Progress
) -> list[float] | None:
    """Run all agents to their end. One that is killed is started again, and goes on from its journal; ``ToolError``
    where one fails. Whatever ends this ends them, too. Returns the CPU time of each, seconds; None where one was
    killed. ``counted``: the number in their lines of JSON that says how far they are, in the end ``totals``."""
    ports = _free_ports(len(commands))
    lines: queue.SimpleQueue[_Line] = queue.SimpleQueue()
    task = progress.start("agents", sum(totals))
    seen = _Seen(counted, totals, [0] * len(commands))
    children: dict[int, _Child] = {}
    try:
        for command in commands:
            children[command.number] = _started(command, ports, lines)
        # Until all have ended well: one that was killed or failed is looked after, whenever that was.
        while any(child.process.poll() != 0 for child in children.values()) or not lines.empty():
            _take(lines, children, seen, progress)
            progress.advance(task, sum(seen.done))
            for command in commands:
                if children[command.number].process.poll():
                    children[command.number] = _again(command, children, ports, lines, seen, progress)
        progress.advance(task, sum(totals))
        in_order = [children[command.number] for command in commands]
        return None if any(child.restarts for child in in_order) else [child.cpu_s for child in in_order]
    finally:
        _end([child.process for child in children.values()])


def _free_ports(count: int) -> list[int]:
    """Ports of this machine that nobody listens on."""
    sockets = [socket.socket() for _ in range(count)]
    try:
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [int(one.getsockname()[1]) for one in sockets]
    finally:
        for one in sockets:
            one.close()


def _started(command: AgentCommand, ports: Sequence[int], lines: queue.SimpleQueue[_Line]) -> _Child:
    pipe = subprocess.PIPE
    process = subprocess.Popen(command.arguments(ports), stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe, text=True)

    def read(is_error: bool) -> None:
        stream = process.stderr if is_error else process.stdout
        assert stream is not None
        for text in stream:
            lines.put(_Line(command.number, text.rstrip(), is_error))

    readers = [threading.Thread(target=read, args=(is_error,), daemon=True) for is_error in (False, True)]
    for reader in readers:
        reader.start()
    return _Child(process, readers)


def _take(lines: queue.SimpleQueue[_Line], children: dict[int, _Child], seen: _Seen, progress: Progress) -> None:
    """What the agents print: how far they are, and what is wrong."""
    until = time.monotonic() + _POLL_S
    while (left := until - time.monotonic()) > 0:
        try:
            line = lines.get(timeout=left)
        except queue.Empty:
            return
        if line.is_error:
            children[line.agent].last_line = line.text
            if "warning" in line.text:
                progress.say(f"agent {line.agent}: {line.text}")
        else:
            step = json.loads(line.text)
            seen.note(line.agent, step)
            children[line.agent].cpu_s = float(step["cpu_s"])


def _again(
    command: AgentCommand,
    children: dict[int, _Child],
    ports: Sequence[int],
    lines: queue.SimpleQueue[_Line],
    seen: _Seen,
    progress: Progress,
) -> _Child:
    """A new process for one that was killed; ``ToolError`` where it failed by itself, or was killed too often."""
    before = children[command.number]
    for reader in before.readers:
        reader.join(_GRACE_S)
    _take(lines, children, seen, progress)  # what it said last
    code = before.process.returncode
    if code > 0 or before.restarts >= _RESTARTS:
        raise ToolError(f"agent {command.number} failed: {before.last_line.removeprefix('maslam: ')}")
    progress.say(f"warning: agent {command.number} was killed (signal {-code}); it goes on from its journal")
    return replace(_started(command, ports, lines), restarts=before.restarts + 1)


def _end(processes: Sequence[subprocess.Popen[str]]) -> None:
    """End those that still run: first kindly."""
    for process in processes:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
    until = time.monotonic() + _GRACE_S
    for process in processes:
        try:
            process.wait(max(until - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
