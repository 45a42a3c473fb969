"""Teams of processes behind relays that lose, delay and swallow what passes: ``python tests/mas/relayed_teams.py [NAME
...]`` (``make relayed``). For each: who is joined, whether all files are there, seconds to notice and to heal.

Not part of the tests: it takes minutes, and its times are of this machine. All agents drive past the same places.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from relay import LinkFaults, Relay
from test_predecessor import write_sequence

from maslam._replaced import replaced
from maslam.mas.live.authority import make_team
from maslam.mas.live.config import LINKS
from maslam.mas.live.team_run import record_team
from maslam.mas.policies.presets import preset
from maslam.mas.sequence import load_sequences
from maslam.tools import cli

FILES = ("journal.bin", "trajectory.tum", "trajectory_keyframes.tum", "graph.g2o", "map.ply")
_START_S, _END_S = 420.0, 420.0


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


@dataclass
class RunningAgent:
    """``steps``: what it printed and when, seconds of this machine's clock."""

    process: subprocess.Popen[str]
    steps: list[tuple[float, dict[str, float]]] = field(default_factory=list)
    said: list[str] = field(default_factory=list)

    def read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith("{"):
                self.steps.append((time.monotonic(), json.loads(line)))
            else:
                self.said.append(line.strip())

    @property
    def neighbours(self) -> int:
        return int(self.steps[-1][1]["neighbours"]) if self.steps else -1


class RelayedTeam:
    """``count`` agents; each connects through a relay of its own to those of lower numbers that ``reaches`` names."""

    def __init__(
        self, folder: Path, count: int, over: str, reaches: Callable[[int, int], bool] = lambda a, b: True
    ) -> None:
        self.folder, self.count, self.over = folder, count, over
        for k in range(count):
            write_sequence(folder / "vo" / f"robot_{k}", k)
        with contextlib.redirect_stdout(sys.stderr):
            assert cli.main(["import", str(folder / "vo"), str(folder / "seqs"), "--quiet"]) == 0
        self.keys = make_team(folder / "keys", "relayed", list(range(count)))
        self.agents: dict[int, RunningAgent] = {}
        self.faults = {(a, b): LinkFaults() for a in range(count) for b in range(a) if reaches(a, b)}
        self.ports = free_ports(count)
        self._stack = contextlib.ExitStack()

    relays: dict[tuple[int, int], Relay]
    direct = False

    def __enter__(self) -> RelayedTeam:
        if self.direct:
            self.relays = {}
            return self
        protocol = "udp" if self.over == "quic" else "tcp"
        self.relays = {
            (a, b): self._stack.enter_context(Relay(protocol, self.ports[b], faults, seed=100 * a + b))
            for (a, b), faults in self.faults.items()
        }
        return self

    def __exit__(self, *_: object) -> None:
        for agent in self.agents.values():
            if agent.process.poll() is None:
                agent.process.kill()
                agent.process.wait()
        self._stack.close()

    def out(self, me: int) -> Path:
        return self.folder / f"out_{me}"

    def start(self, me: int, speed: float) -> None:
        mine = f"{self.over}/127.0.0.1:{self.ports[me]}"
        ports = {pair: relay.port for pair, relay in self.relays.items()} or {
            pair: self.ports[pair[1]] for pair in self.faults
        }
        others = [f"{self.over}/127.0.0.1:{port}" for (a, _), port in ports.items() if a == me]
        words = [str(self.folder / "seqs"), str(self.out(me)), "--credentials", str(self.keys[me])]
        words += ["--json", "--speed", str(speed), "--listen", mine, *(w for o in others for w in ("--connect", o))]
        process = subprocess.Popen(
            [sys.executable, "-m", "maslam", "agent", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.agents[me] = RunningAgent(process)
        threading.Thread(target=self.agents[me].read, daemon=True).start()

    def until(self, done: Callable[[], bool], limit_s: float, what: str) -> float:
        """Seconds until it is so; nan where it is not within the limit."""
        began = time.monotonic()
        while not done():
            if time.monotonic() - began > limit_s:
                say(f"  {what}: not within {limit_s:.0f} s")
                return float("nan")
            time.sleep(0.05)
        return time.monotonic() - began

    def meet(self, speed: float, who: list[int] | None = None) -> None:
        who = list(range(self.count)) if who is None else who
        for me in who:
            self.start(me, speed)
        took = self.until(
            lambda: all(self.agents[me].neighbours >= len(who) - 1 for me in who), _START_S, "all have met all"
        )
        begun = max((self.agents[me].steps or [(time.monotonic(), {})])[0][0] for me in who)
        say(f"  all have met all {took:.1f} s after their start, {time.monotonic() - begun:.1f} s after the last began")

    def end(self) -> None:
        """Wait for the end of all; print who is joined and what is missing."""
        ended = self.until(
            lambda: all(a.process.poll() is not None for a in self.agents.values()), _END_S, "all have ended"
        )
        codes = {me: a.process.poll() for me, a in sorted(self.agents.items())}
        missing = [f"out_{me}/{name}" for me in self.agents for name in FILES if not (self.out(me) / name).is_file()]
        manifest, sequences = load_sequences(self.folder / "seqs")
        config = replaced(preset("maslam"), link=LINKS["cable"])
        journals = [self.out(me) / "journal.bin" for me in range(self.count)]
        summary = record_team(manifest, sequences, config, journals, self.folder / "run", 1.0)
        last = [agent.steps[-1][1] for agent in self.agents.values() if agent.steps]
        bytes_ = {name: sum(int(one[name]) for one in last) for name in ("message_bytes", "frame_bytes")}
        lost = sum(r.lost for r in self.relays.values())
        passed = sum(r.passed for r in self.relays.values())
        say(f"  ended after {ended:.1f} s more, exit codes {codes}; groups {summary.groups}")
        say(f"  missing files: {missing or 'none'}; false matches: {summary.matches.false_accepted}")
        say(f"  {bytes_}; relays passed {passed}, lost {lost}")
        for me, agent in sorted(self.agents.items()):
            for text in [t for t in agent.said if t][-3:]:
                say(f"    agent {me}: {text}")


def free_ports(count: int) -> list[int]:
    """Ports that nobody uses, by TCP nor UDP."""
    ports: list[int] = []
    while len(ports) < count:
        with socket.socket() as one, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            one.bind(("127.0.0.1", 0))
            with contextlib.suppress(OSError):
                other.bind(one.getsockname())
                ports.append(int(one.getsockname()[1]))
    return ports


def loss(folder: Path) -> None:
    """Four agents over QUIC, 30 % of datagrams lost in both directions."""
    with RelayedTeam(folder, 4, "quic") as team:
        for faults in team.faults.values():
            faults.loss = 0.3
        team.meet(1.0)
        team.end()


def delay(folder: Path) -> None:
    """Four agents over TLS, half a second in each direction."""
    with RelayedTeam(folder, 4, "tls") as team:
        for faults in team.faults.values():
            faults.delay_s = 0.5
        team.meet(1.0)
        team.end()


def black_hole(folder: Path, over: str = "quic") -> None:
    """Four agents; agent 3 is cut off for 10 s while all drive."""
    with RelayedTeam(folder, 4, over) as team:
        team.meet(0.3)
        cut = [faults for pair, faults in team.faults.items() if 3 in pair]
        began = time.monotonic()
        for faults in cut:
            faults.cut = True
        noticed = team.until(lambda: team.agents[0].neighbours == 2, 10.0, "the others notice")
        noticed_too = team.until(lambda: team.agents[3].neighbours == 0, 10.0, "agent 3 notices")
        time.sleep(max(10.0 - (time.monotonic() - began), 0.0))
        for faults in cut:
            faults.cut = False
        healed = team.until(
            lambda: team.agents[3].neighbours == 3 and team.agents[0].neighbours == 3, 30.0, "all see all again"
        )
        say(f"  noticed after {noticed:.1f} s, by agent 3 {noticed + noticed_too:.1f} s; healed {healed:.1f} s after")
        team.end()


def black_hole_tls(folder: Path) -> None:
    """The same over TLS."""
    black_hole(folder, "tls")


def killed(folder: Path, over: str = "quic") -> None:
    """Four agents; agent 1 is killed with -9 while all drive, and started again."""
    with RelayedTeam(folder, 4, over) as team:
        team.meet(0.3)
        team.agents[1].process.kill()
        noticed = team.until(lambda: team.agents[0].neighbours == 2, 10.0, "the others notice")
        team.start(1, 0.3)
        team.until(lambda: bool(team.agents[1].steps), _START_S, "agent 1 begins again")
        healed = team.until(lambda: all(a.neighbours == 3 for a in team.agents.values()), 30.0, "all see all again")
        say(f"  noticed after {noticed:.1f} s; healed {healed:.1f} s after its process had begun again")
        team.end()


def killed_tls(folder: Path) -> None:
    """The same over TLS, and the process is started again at once."""
    killed(folder, "tls")


def chain(folder: Path) -> None:
    """Seven agents over TLS; agent k reaches only k-1 and k+1: six hops from end to end."""
    with RelayedTeam(folder, 7, "tls", lambda a, b: a - b == 1) as team:
        team.meet(0.3)
        team.end()


def late(folder: Path) -> None:
    """Agents 0 to 2 drive; agent 3 comes later, agent 2 goes in between (SIGTERM)."""
    with RelayedTeam(folder, 4, "quic") as team:
        team.meet(0.3, [0, 1, 2])
        team.start(3, 1.0)
        team.until(lambda: bool(team.agents[3].steps), _START_S, "agent 3 begins")
        took = team.until(lambda: team.agents[3].neighbours == 3, 30.0, "agent 3 has met all")
        team.agents[2].process.send_signal(signal.SIGTERM)
        left = team.until(lambda: team.agents[0].neighbours == 2, 10.0, "the others notice that agent 2 has left")
        say(f"  agent 3 met all {took:.1f} s after it had begun; agent 2's leaving noticed after {left:.1f} s")
        team.end()


def twenty(folder: Path) -> None:
    """Twenty agents over TLS, all connected to all, without relays: bytes, memory and CPU time of each."""
    team = RelayedTeam(folder, 20, "tls")
    team.direct = True
    with team:
        team.meet(0.04)
        begun = [used(a.process.pid) for a in team.agents.values()]
        joining = [(int(a.steps[-1][1]["greeting_bytes"]), int(a.steps[-1][1]["seen"])) for a in team.agents.values()]
        took_s = 0.0
        last = begun
        while any(a.process.poll() is None for a in team.agents.values()) and took_s < _END_S:
            time.sleep(1.0)
            took_s += 1.0
            last = [used(a.process.pid) or before for a, before in zip(team.agents.values(), last, strict=True)]
        seen = 10 - sum(count for _, count in joining) / len(joining)
        cpu_s = [after[0] - before[0] for after, before in zip(last, begun, strict=True) if after and before]
        megabytes = [one[1] for one in last if one]
        say(
            f"  CPU time an agent {sum(cpu_s) / len(cpu_s):.2f} s for {seen:.1f} key-frames; memory {max(megabytes)} MB"
        )
        say(f"  greetings {sum(count for count, _ in joining) / len(joining):.0f} bytes an agent")
        team.end()


def used(pid: int) -> tuple[float, int] | None:
    """CPU time of a process, seconds, and its memory now, MB."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK"), int(words[21]) * os.sysconf(
            "SC_PAGE_SIZE"
        ) // 2**20
    except (OSError, IndexError):
        return None


SCENARIOS = {
    one.__name__: one for one in (loss, delay, black_hole, black_hole_tls, killed, killed_tls, chain, late, twenty)
}


def main(names: list[str]) -> None:
    for name in names or list(SCENARIOS):
        say(f"{name}: {(SCENARIOS[name].__doc__ or '').strip()}")
        with tempfile.TemporaryDirectory(prefix="maslam-relayed-") as folder:
            SCENARIOS[name](Path(folder))


if __name__ == "__main__":
    main(sys.argv[1:])
