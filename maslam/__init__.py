"""Multi-agent visual SLAM without a server: from folders of images to one shared map, on a CPU.

    import maslam

    run = maslam.slam("images", "out", agents=4)
    print(run.summary.ate_rmse_m.mean_agents, run.summary.matches.accepted, run.report)

Everything in ``__all__`` is loaded when it is first asked for; ``import maslam`` costs no library. Functions take plain
paths and keywords, print nothing, and raise :class:`MaslamError` with one line for people. A call gives the same files
as the command of the same name, on any number of cores; inside a call BLAS runs on one thread.

Below this face the code stands in five folders: ``maslam.frontend``, ``maslam.descriptors``, ``maslam.backend``,
``maslam.mas``, ``maslam.tools``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from ._links import check_links

check_links()

if TYPE_CHECKING:
    from .api.agent import Agent
    from .api.datasets import open_dataset
    from .api.evaluation import evaluate
    from .api.graphs import optimise, optimise_distributed, read_g2o, write_g2o
    from .api.interchange import export, import_sequence
    from .api.odometry import Odometry
    from .api.pipeline import preprocess, run, slam
    from .api.results import AgentResult, MatchResult, Run, Sequences
    from .api.watch import Watch
    from .api.worlds import render
    from .backend.central.optimise import OptimisationResult
    from .backend.distributed.exchange import GroupResult
    from .backend.geometry import Sim3
    from .backend.pose_graph.graph import Edge, NodeId, PoseGraph
    from .backend.robust.select import RobustResult
    from .backend.trajectory_error import TrajectoryError
    from .descriptors.base import PlaceDescriptor as Descriptor
    from .descriptors.inference import NetVlad
    from .errors import MaslamError
    from .frontend.cameras.models import PinholeCamera, Rig, RigKind
    from .frontend.config import OdometryConfig
    from .frontend.datasets.base import Dataset, ImageSequence, Reader
    from .frontend.files.trajectory import Trajectory
    from .frontend.frames import Frame
    from .frontend.odometry import FrameResult, OdometryResult
    from .mas.config import MasConfig
    from .mas.evaluation.summary import Summary
    from .mas.live.team_pose import TeamMap, TeamPose
    from .mas.live.topic_reader import AgentMap, AgentPose
    from .mas.policies.base import Outlook, Policy
    from .mas.policies.presets import preset
    from .mas.protocol.messages import Bid
    from .mas.state.agent_state import AgentState
    from .mas.transport.transport import HandedOver, Transport
    from .tools.interchange.export_request import Exported

    __version__: str

__all__ = [
    "Agent",
    "AgentMap",
    "AgentPose",
    "AgentResult",
    "AgentState",
    "Bid",
    "Dataset",
    "Descriptor",
    "Edge",
    "Exported",
    "Frame",
    "FrameResult",
    "GroupResult",
    "HandedOver",
    "ImageSequence",
    "MasConfig",
    "MaslamError",
    "MatchResult",
    "NetVlad",
    "NodeId",
    "Odometry",
    "OdometryConfig",
    "OdometryResult",
    "OptimisationResult",
    "Outlook",
    "PinholeCamera",
    "Policy",
    "PoseGraph",
    "Reader",
    "Rig",
    "RigKind",
    "RobustResult",
    "Run",
    "Sequences",
    "Sim3",
    "Summary",
    "TeamMap",
    "TeamPose",
    "Trajectory",
    "TrajectoryError",
    "Transport",
    "Watch",
    "__version__",
    "evaluate",
    "export",
    "import_sequence",
    "open_dataset",
    "optimise",
    "optimise_distributed",
    "preprocess",
    "preset",
    "read_g2o",
    "render",
    "run",
    "slam",
    "write_g2o",
]

_PLACES = {
    "api.agent": ("Agent",),
    "api.datasets": ("open_dataset",),
    "api.evaluation": ("evaluate",),
    "api.graphs": ("optimise", "optimise_distributed", "read_g2o", "write_g2o"),
    "api.interchange": ("export", "import_sequence"),
    "api.odometry": ("Odometry",),
    "api.pipeline": ("preprocess", "run", "slam"),
    "api.results": ("AgentResult", "MatchResult", "Run", "Sequences"),
    "api.watch": ("Watch",),
    "api.worlds": ("render",),
    "backend.central.optimise": ("OptimisationResult",),
    "backend.distributed.exchange": ("GroupResult",),
    "backend.geometry": ("Sim3",),
    "backend.pose_graph.graph": ("Edge", "NodeId", "PoseGraph"),
    "backend.robust.select": ("RobustResult",),
    "backend.trajectory_error": ("TrajectoryError",),
    "descriptors.base": ("Descriptor=PlaceDescriptor",),
    "descriptors.inference": ("NetVlad",),
    "errors": ("MaslamError",),
    "frontend.cameras.models": ("PinholeCamera", "Rig", "RigKind"),
    "frontend.config": ("OdometryConfig",),
    "frontend.datasets.base": ("Dataset", "ImageSequence", "Reader"),
    "frontend.files.trajectory": ("Trajectory",),
    "frontend.frames": ("Frame",),
    "frontend.odometry": ("FrameResult", "OdometryResult"),
    "mas.config": ("MasConfig",),
    "mas.evaluation.summary": ("Summary",),
    "mas.live.team_pose": ("TeamMap", "TeamPose"),
    "mas.live.topic_reader": ("AgentMap", "AgentPose"),
    "mas.policies.base": ("Outlook", "Policy"),
    "mas.policies.presets": ("preset",),
    "mas.protocol.messages": ("Bid",),
    "mas.state.agent_state": ("AgentState",),
    "mas.transport.transport": ("HandedOver", "Transport"),
    "tools.interchange.export_request": ("Exported",),
}
_PLACE_OF = {name.partition("=")[0]: (place, name.partition("=")[2]) for place, ns in _PLACES.items() for name in ns}


def _load(name: str) -> object:
    """Load what is asked for (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version

        return version("maslam")
    if name not in _PLACE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    place, inside = _PLACE_OF[name]
    value = getattr(import_module(f".{place}", __name__), inside or name)
    globals()[name] = value
    return value


if not TYPE_CHECKING:  # a type checker takes every name for known that a module's __getattr__ might give
    __getattr__ = _load


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
