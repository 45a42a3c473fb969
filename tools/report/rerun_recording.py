"""A run as a recording for the rerun viewer: trajectories and map points of all agents, replayed along the agents'
clock.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import replacing

from ..common.errors import ToolError
from ..common.figures import colour_of
from .run_data import RunData, read_run

CLOCK = "agents' time"


def write_recording(run: Path, path: Path) -> Path:
    """Write ``path`` (.rrd) of a finished run in one move; ``ToolError`` where rerun is not installed."""
    try:
        import rerun as rr
    except ModuleNotFoundError as error:
        raise ToolError("a recording needs the rerun SDK: pip install 'maslam[rerun]'") from error
    data = read_run(run)
    recording = rr.RecordingStream("maslam", recording_id=f"maslam-{data.summary['seed']}", send_properties=False)
    with replacing(path) as part:
        recording.save(part)
        recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)
        for agent in data.agents:
            _log_agent(rr, recording, data, agent.index)
        recording.flush()
        recording.disconnect()
    return path


def _log_agent(rr: Any, recording: Any, data: RunData, index: int) -> None:
    """Truth, map points and path stand still; the camera moves along them."""
    agent, positions = data.agents[index], data.in_world[index]
    colour = tuple(int(colour_of(index)[k : k + 2], 16) for k in (1, 3, 5))
    if agent.truth is not None:
        truth = rr.LineStrips3D([agent.truth.centres], colors=[(170, 180, 190)])
        recording.log(f"world/truth/{agent.name}", truth, static=True)
    points = own_points(data.folder / agent.name / "map.ply", index)
    placed = data.T_world_agent[index] @ points
    recording.log(f"world/{agent.name}/map", rr.Points3D(placed, colors=[colour], radii=0.03), static=True)
    recording.log(f"world/{agent.name}/path", rr.LineStrips3D([positions], colors=[colour]), static=True)
    for stamp_ns, position in zip(agent.estimate.stamps_ns.tolist(), positions, strict=True):
        recording.set_time(CLOCK, duration=(stamp_ns - agent.start_ns) / 1e9)
        here = rr.Points3D([position], colors=[colour], labels=[agent.name], radii=0.3)
        recording.log(f"world/{agent.name}/camera", here)


def own_points(path: Path, owner: int) -> NDArray[np.float64]:
    """The points ``(n, 3)`` of the agent's own map, out of all that it holds; none where it has no map."""
    if not path.is_file():
        return np.zeros((0, 3))
    head, _, body = path.read_bytes().partition(b"end_header\n")
    kinds = {"float": "<f4", "uchar": "u1", "ushort": "<u2"}
    properties = [line.split()[1:] for line in head.decode("ascii").splitlines() if line.startswith("property")]
    rows = np.frombuffer(body, dtype=[(name, kinds[kind]) for kind, name in properties])
    own = rows[rows["agent"] == owner]
    return np.column_stack([own["x"], own["y"], own["z"]]).astype(np.float64)
