"""What one agent of a network knows at its end, in its own folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from maslam._atomic import write_atomically

from ..common.memory import peak_mb

if TYPE_CHECKING:
    from maslam.mas.agent import Agent
    from maslam.mas.live.process import AgentProcess
    from maslam.mas.sequence import AgentSequence


PROCESS = "process.json"


def write_process_figures(out: Path, process: AgentProcess, topic_bytes: int = 0) -> None:
    """``process.json``: bytes to and from each other agent by what they are for (``sent``, ``received``), of signatures
    in the messages sent, and on topics; frames and greetings that were refused; CPU time by part (``start``: until the
    agent was there), and the peak of memory, MB."""
    from maslam.mas.live.link_bytes import link_figures

    neighbours, cpu = process.neighbours, process.cpu
    figures = {
        **link_figures(neighbours.out, neighbours.into),
        "signature_bytes": process.signatures.sent_bytes,
        "topic_bytes": topic_bytes,
        "refused": neighbours.refused,
        "cpu_s": {"start": round(cpu.began_s, 6), **{name: round(s, 6) for name, s in cpu.seconds().items()}},
        "peak_mb": round(peak_mb(), 1),
    }
    write_atomically(out / PROCESS, json.dumps(figures, indent=1) + "\n")


def write_own_results(out: Path, agent: Agent, sequence: AgentSequence) -> None:
    """``trajectory.tum``, ``trajectory_keyframes.tum``, ``graph.g2o``, ``map.ply`` (its own map with the copies of
    others that it bought), each whole or not at all; times are the images' own unless the settings say otherwise."""
    from maslam.backend.pose_graph.g2o import write_g2o
    from maslam.frontend.files.trajectory import write_tum
    from maslam.mas.map_exchange.full_map import own_map
    from maslam.mas.output.fused_map import fused, write_map
    from maslam.mas.output.run_folder import later
    from maslam.mas.state.pose_graph import own_graph
    from maslam.mas.state.trajectories import frame_trajectory, keyframe_trajectory

    state = agent.state
    start_ns = sequence.start_ns if state.config.times == "images" else 0
    write_tum(out / "trajectory.tum", later(frame_trajectory(state, sequence), start_ns))
    write_tum(out / "trajectory_keyframes.tum", later(keyframe_trajectory(state), start_ns))
    if state.keyframes:
        write_g2o(out / "graph.g2o", own_graph(state))
        copies = [copy for _, copy in sorted(agent.maps.copies.items())]
        write_map(out / "map.ply", fused([own_map(state), *copies]))
