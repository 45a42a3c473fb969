"""A team of processes beside the simulation of the same agents: ``python tests/mas/team_comparison.py SEQS OUT``.

For the simulator, and for processes over TLS and over QUIC, all connected to all on this machine: groups, error, false
matches; bytes of messages and of the frames that carried them, in all and between the two agents where the ratio is
worst; greetings; CPU time and memory of a process. Not part of the tests: it takes minutes.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from statistics import mean
from typing import Any

from maslam.tools import cli

_LITTLE_BYTES = 5000


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def result_of(run: Path) -> str:
    """Who is joined, how well, and false matches."""
    summary = json.loads((run / "summary.json").read_text())
    errors, matches, groups = summary["ate_rmse_m"], summary["matches"], summary["groups"]
    sizes = sorted((len(group) for group in groups), reverse=True)
    return (
        f"groups {sizes}; ATE RMSE agents {errors['mean_agents']:.4f}, maps {errors['mean_maps']:.4f} m, mean error "
        f"{summary['ate_mean_m']['mean_agents']:.4f}, {summary['ate_mean_m']['mean_maps']:.4f}; "
        f"{matches['accepted']} matches, {matches['false_accepted']} false; "
        f"{summary['traffic']['total']['wire_bytes']} bytes of messages; {summary['keyframes']} key-frames"
    )


def processes_of(run: Path) -> list[dict[str, Any]]:
    return [json.loads(path.read_text()) for path in sorted((run / "journals").glob("agent_*/process.json"))]


def link_of(run: Path) -> str:
    """Bytes that the processes sent, all together, and between the two where frames are longest beside messages."""
    processes = processes_of(run)
    names = ("message_bytes", "data_bytes", "control_bytes", "greeting_bytes", "frames")
    total = {name: sum(p["sent"]["all"][name] for p in processes) for name in names}
    hops = [one for p in processes for other, one in p["sent"].items() if other != "all"]
    large = [h for h in hops if h["message_bytes"] >= _LITTLE_BYTES]
    worst = max((h["data_bytes"] / h["message_bytes"] for h in large), default=0.0)
    lost = 1 - sum(p["received"]["all"]["message_bytes"] for p in processes) / total["message_bytes"]
    return (
        f"{total}; data frames {total['data_bytes'] / total['message_bytes']:.3f} x messages, from one to another at "
        f"most {worst:.3f} (of {_LITTLE_BYTES} bytes and more); {100 * lost:.2f} % of message bytes did not arrive"
    )


def load_of(run: Path) -> str:
    processes = processes_of(run)
    parts = {name: mean(p["cpu_s"].get(name, 0.0) for p in processes) for name in processes[0]["cpu_s"]}
    spent = sum(seconds for name, seconds in parts.items() if name != "start")
    shares = ", ".join(f"{name} {seconds:.2f}" for name, seconds in parts.items())
    megabytes = [p["peak_mb"] for p in processes]
    return f"CPU time an agent {spent:.2f} s ({shares}); memory {mean(megabytes):.0f} MB, at most {max(megabytes):.0f}"


def main(sequences: str, out: str, speed: str = "1", overs: str = "tls,quic") -> None:
    simulated = Path(out) / "simulated"
    if not (simulated / "summary.json").exists():
        assert cli.main(["run", sequences, str(simulated), "--quiet"]) == 0
    say(f"simulated: {result_of(simulated)}")
    for over in overs.split(","):
        run = Path(out) / over
        assert cli.main(["team", sequences, str(run), "--over", over, "--speed", speed, "--quiet"]) == 0
        say(f"{over}: {result_of(run)}")
        say(f"  {link_of(run)}")
        say(f"  {load_of(run)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
