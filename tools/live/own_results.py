"""What one agent of a network knows at its end, in its own folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from maslam.mas.agent import Agent
    from maslam.mas.sequence import AgentSequence


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
