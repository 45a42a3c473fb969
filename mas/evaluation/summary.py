"""``summary.json``: all figures of a run (thesis Table 3.2 and more). Names of version 0.1 are read as well."""

from __future__ import annotations

from pydantic import AliasChoices, BaseModel, ConfigDict, Field

from ..manifest import LeftOutEntry, LostEntry, MissingEntry
from .earlier_figures import EarlierFigures
from .load_figures import LoadFigures
from .undecided_figures import UndecidedFigures


class _Figures(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Errors(_Figures):
    """Position errors in metres; None without ground truth. Lists have one value an agent.

    ``agents``: each trajectory under its own alignment (SE(3), Sim(3) if monocular); ``maps``: own key-frames and map
    copies together, under one alignment; ``connected``: own key-frames under one alignment for all agents in its frame.
    """

    agents: list[float | None]
    maps: list[float | None]
    connected: list[float | None]
    mean_agents: float | None
    mean_maps: float | None


class MeasuredOn(_Figures):
    """What an error was measured on and after: ``kind``: SE(3) or Sim(3); ``scale``: metres of the truth in one unit
    of the estimate (1 with SE(3)); ``frames``: poses that have a true one: frames of a trajectory, key-frames of
    maps. ``tracks``, of odometry only: each was aligned by itself, and ``scale`` is that of the longest."""

    kind: str
    scale: float
    frames: int
    tracks: int | None = None


class Alignments(_Figures):
    """The alignment behind each error, one an agent, None where there is none: ``agents``, ``maps``, ``connected`` of
    :class:`Errors`, and ``odometry``."""

    agents: list[MeasuredOn | None]
    maps: list[MeasuredOn | None]
    connected: list[MeasuredOn | None]
    odometry: list[MeasuredOn | None]


class Coverage(_Figures):
    """How much of what an agent read has a place in the end: frames ``read``, ``tracked`` (by odometry) and ``placed``
    (in the agent's reference frame); its ``tracks`` and those that are joined, ``tracks_placed``; intervals of ``lost``
    and of ``doubtful`` frames; images ``missing`` in the source's numbering. ``sequence``: name of the images in the
    source."""

    sequence: str
    read: int
    tracked: int
    placed: int
    tracks: int
    tracks_placed: int
    lost: list[LostEntry]
    doubtful: list[LostEntry] = []
    missing: list[MissingEntry] = []


class OneFrame(_Figures):
    """The largest group: ``agents`` that share one frame, ``of`` all that there should be, those without a place
    included: agents without a placed frame, sequences without an agent (``without``: ``agent_02``, ``sequence dark``).
    """

    agents: int
    of: int
    without: list[str]


class TrafficFigures(_Figures):
    """Messages of one operation, and their bytes by two counts."""

    messages: int
    payload_bytes: int = Field(description="as the published tables count")
    wire_bytes: int = Field(description="exact length of the encoded messages")


class MatchFigures(_Figures):
    """``candidates``: below the distance threshold; ``verified``: passed the geometric check; ``accepted``: used;
    ``rejected``: checked and not used, by reason; ``skipped``: not checked, by reason; the three
    together are all candidates. ``same_image``: those of them whose key-frames are of one and the same image, which two
    agents were given: no evidence, never accepted. ``wider``: verified beyond the strict distance because their agents
    or tracks were not in one frame, ``wider_accepted`` of them, for ``wider_traffic``, which stands in the operations'
    figures too. ``false_accepted``: against ground truth, None without;
    ``own_loops``: those among ``accepted`` that an agent found with itself; ``between_agents``: the rest."""

    candidates: int
    verified: int
    accepted: int
    rejected: dict[str, int]
    skipped: dict[str, int] = Field(default={}, description="empty, too: a run before they were counted apart")
    same_image: int = Field(default=0, description="0, too: a run before they were counted apart")
    wider: int = Field(default=0, description="0, too: a run before there were any")
    wider_accepted: int = 0
    wider_traffic: TrafficFigures = TrafficFigures(messages=0, payload_bytes=0, wire_bytes=0)
    own_loops: int
    between_agents: int
    false_accepted: int | None


class OptimisationFigures(_Figures):
    """Sums over all optimisations of the run; no single one ends with a higher cost than it began. ``updates``: how
    often what one had solved was solved again with matches that came later, instead of another optimisation.
    ``undecided``: what robust selection by elected agents left open in the last optimisations."""

    count: int
    updates: int = 0
    iterations: int
    cost_before: float
    cost_after: float
    undecided: list[UndecidedFigures] = []


class MisfitFigures(_Figures):
    """An edge that does not fit: its ``ends`` as agent:key-frame, its ``kind``, its share of the cost, whose square
    root is its error in standard deviations."""

    ends: list[str]
    kind: str
    cost: float


class GraphFigures(_Figures):
    """How well the graph of one group of ``agents`` fits in the end: its ``cost`` F (SE-Sync; residuals in standard
    deviations) and degrees of freedom ``dof``, which a cost of mere noise is about; ``fits``: it is not far above;
    ``worst``: the edges with the largest shares. ``lengths``: what each agent's odometry was found to have to be
    multiplied by, 1 where it stayed as it was; ``turns_deg_m``: by how much more it is to turn about each axis of
    the camera, degrees a metre. ``odometry_sigmas``: errors of metric agents' odometry over the stated
    standard deviations, by the number of key-frames that they have added up over, as loops and matches tell; empty
    where these tell nothing."""

    agents: list[int]
    edges: int
    cost: float
    dof: int
    fits: bool
    worst: list[MisfitFigures]
    lengths: list[float] = []
    turns_deg_m: list[list[float]] = []
    odometry_sigmas: dict[str, float] = {}


class TruthFigures(_Figures):
    """Whether the ground truth of ``agent`` can be of its images, on the ``frames`` of its longest track that have one:
    the lengths of odometry's path and the true one, odometry's RMSE against it, and ``spread_m``: root mean square
    distance of the true positions from their mean. ``metric``: lengths are compared, not only shapes. ``cause``: what
    may be wrong where it does not fit, else empty; ``rotations``: what may be wrong with these alone, else empty."""

    agent: int
    metric: bool
    frames: int
    odometry_m: float
    truth_m: float
    rmse_m: float
    spread_m: float
    fits: bool
    cause: str = ""
    rotations: str = ""


class DatumFigures(_Figures):
    """The place that metres east, north and up count from: degrees, metres above the ellipsoid (WGS 84)."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


class GeoreferenceFigures(_Figures):
    """How the map of one group of ``agents`` lies on the positions measured from outside (GPS): their number, those
    ``far_off`` by more than three standard deviations, the others' root mean square distances; ``scale``: metres in
    one unit of the map; ``rotation_sigma_deg``: how well its rotation is known. ``reason``: why it has no place there;
    empty where it has."""

    agents: list[int]
    positions: int
    far_off: int = 0
    rms_horizontal_m: float | None = None
    rms_vertical_m: float | None = None
    scale: float | None = None
    rotation_sigma_deg: float | None = None
    reason: str = ""


class PositionFigures(_Figures):
    """Positions measured from outside (GPS). ``datum``: None where they were given in metres; ``used``: whether the
    solver took them as priors; ``groups``: of agents in one frame, where each lies."""

    datum: DatumFigures | None
    used: bool
    groups: list[GeoreferenceFigures]


class MapCopyFigures(_Figures):
    """One map copy: errors under its holder's alignment; ``points_off_m``: median distance of its points from where
    their owner has them at the end (null: in other coordinates, or in a unit that nothing relates to metres)."""

    holder: int
    owner: int
    version: int
    keyframes: int
    points: int
    ate_rmse_m: float | None
    ate_mean_m: float | None
    points_off_m: float | None


class ReputationFigures(_Figures):
    """Reputation of one agent with the others, by their own contracts with it.

    ``delivered``, ``failed``, ``expired``: contracts it had with them as contractor; ``contradicted``: matches it
    verified that others contradict; ``mean``, ``lowest``: its reputation with them, 0 to 1; ``not_called_by``: agents
    that do not call it any more.
    """

    agent: int
    delivered: int
    failed: int
    expired: int
    contradicted: int
    mean: float | None
    lowest: float | None
    not_called_by: list[int] = Field(validation_alias=AliasChoices("not_called_by", "shunned_by"))


class FaultFigures(_Figures):
    """Faults made on purpose, and what the agents did about them: ``repeated``: messages of contracts and of solvers
    that were sent again; ``lost_bytes``: wire bytes of those lost, which the traffic counts as sent."""

    lost: int
    lost_bytes: int = 0
    doubled: int
    repeated: int


class Timing(_Figures):
    """Measured times of a run on this machine, no result of it: ``timing.json``. Seconds of wall time, and how many
    times as fast as the sequences were recorded. ``agents_cpu_s``: CPU time of each agent's process, None where all
    were in one, or one was killed on the way."""

    wall_s: float
    realtime_factor: float
    agents_cpu_s: list[float] | None = None


class Summary(_Figures):
    """``groups``: agents that share one coordinate frame at the end. ``odometry_*``: errors before any optimisation, of
    the same frames, each track under an alignment of its own. ``path_length_m`` from ground truth.
    ``exploration_percent``: of each agent, frames that have a place in its own map or in a copy it holds (of a copy
    those between neighbouring key-frames, of which it holds both), over all frames read of all agents, each counted
    once. ``refused_messages``: dropped as unbelievable."""

    version: str
    preset: str
    policy: str = Field(default="", description="who decided; empty: a run before it was written")
    seed: int
    place_code: str = Field(default="float32", description="how place vectors travelled")
    place_code_bytes: int | None = Field(
        default=None, description="of one place vector; None: a run before it was written"
    )
    scale: str
    times: str = Field(default="agent", description="of trajectories: the images' own, or from each agent's start")
    agents: int
    keyframes: int
    keyframes_placed: list[int]
    duration_s: float
    steps: int
    groups: list[list[int]]
    one_frame: OneFrame | None = Field(default=None, description="None: a run before it was written")
    ate_rmse_m: Errors
    ate_mean_m: Errors
    odometry_rmse_m: list[float | None]
    odometry_mean_rmse_m: float | None
    path_length_m: list[float | None]
    exploration_percent: list[float]
    alignments: Alignments | None = Field(default=None, description="None: a run before they were written")
    coverage: list[Coverage] = Field(default=[], description="of each agent; empty: a run before it was written")
    left_out: list[LeftOutEntry] = Field(default=[], description="sequences of the source without an agent")
    traffic: dict[str, TrafficFigures]
    matches: MatchFigures
    optimisations: OptimisationFigures
    graphs: list[GraphFigures] = Field(default=[], description="of each group; empty: a run before they were checked")
    truths: list[TruthFigures] = Field(default=[], description="of each agent with ground truth that tells")
    map_copies: list[MapCopyFigures]
    load: list[LoadFigures] = Field(default=[], description="of each agent; empty: a run before it was written")
    positions: PositionFigures | None = Field(default=None, description="None: no agent had any")
    earlier: EarlierFigures | None = Field(default=None, description="None: onto no earlier run")
    refused_messages: int
    reputation: list[ReputationFigures] = Field(
        default=[], validation_alias=AliasChoices("reputation", "standing"), description="of each agent with the others"
    )
    faults: FaultFigures | None = Field(default=None, description="None: none were made")
