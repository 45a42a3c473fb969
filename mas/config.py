"""Settings of the multi-agent system. Every default states its unit; an unknown key is an error."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator
from pydantic_core import PydanticCustomError

from maslam._settings import Settings
from maslam._suggestions import UNKNOWN_NAME, hint
from maslam.backend.config import RelPoseConfig, SolverConfig
from maslam.descriptors.codes import CODES, is_code

AUTO_CODE = "auto"
"""The shortest place code that serves: product code where the model has codebooks, else int8."""


class PlacesConfig(Settings):
    """Place recognition between agents and own loop closures (thesis section 3.5)."""

    threshold: float | None = Field(
        default=None,
        gt=0,
        le=2,
        description="places match below this distance of unit vectors, 0 to 2; unset: the descriptor's own",
    )
    certainty: Literal["candidate", "strict"] = Field(
        default="candidate",
        description="which of the descriptor's own distances: candidate keeps nearly all right matches, strict lets "
        "geometry verify fewer wrong ones",
    )
    widen_keyframes: int | None = Field(
        default=None,
        ge=1,
        description="while agents are not in one frame, verify one pair beyond the strict distance, within the "
        "candidate's, for each so many own key-frames, and eight of a group at the end; null: never",
    )
    code: str = Field(
        default="int8",
        description="how a place vector travels: float32, int8, int4 (x128: its first 128 numbers only), pq32, pq16; "
        "auto: pq32 where the model has codebooks, else int8",
    )
    latest_frames: int = Field(
        default=1,
        ge=1,
        description="key-frames of an asker that are matched: earlier queries again, unsent ones after a hit",
    )
    centres_from: str | None = Field(
        default=None,
        description="clustered: netvlad.npz whose vectors the owners' centres are fitted to; unset: this run's own",
    )
    features: Literal["descriptors", "words"] = Field(
        default="descriptors", description="what a verification sends for each point"
    )
    max_points: int = Field(
        default=500, ge=20, le=20_000, description="map points of a key-frame sent for verification, at most"
    )
    first_points: int = Field(
        default=0,
        ge=0,
        description="so many of them at first, the rest only where those promise a match; 0: all at once",
    )
    first_evidence: float = Field(
        default=6.0, description="log odds that the first points must bring to be believed without the rest"
    )
    point_code: Literal["float", "grid"] = Field(
        default="float",
        description="how positions travel: 12 bytes each, or 4 on a grid of directions and inverse depths",
    )
    descriptor_bytes: Literal[8, 16, 32] = Field(default=32, description="of each descriptor, its first bytes")
    gap_keyframes: int = Field(
        default=4,
        ge=0,
        description="own key-frames that pass between accepted matches with one agent; no verification sooner",
    )
    gap_most_keyframes: int | None = Field(
        default=None,
        ge=0,
        description="grown up to so many where matches come as expected, so that they tell little; null: no",
    )
    gap_least_keyframes: int | None = Field(
        default=None,
        ge=0,
        description="shrunk down to so many where matches show that odometry has drifted; null: not below "
        "gap_keyframes",
    )
    closing_ends: bool = Field(
        default=False,
        description="once all is seen, verify with each agent skipped pairs, one after the other, where odometry is "
        "expected to have drifted since the nearest matches",
    )
    gap_m: float = Field(
        default=0.0, ge=0, description="likewise travel, metres (own unit if monocular); the predecessor's is 10"
    )
    own_loops: bool = Field(default=True, description="close loops with the agent's own earlier key-frames")
    own_age_s: float = Field(
        default=30.0, ge=0, description="own key-frames at least this much older are candidates, seconds ..."
    )
    own_apart_keyframes: int | None = Field(
        default=15,
        ge=1,
        description="... if so many key-frames lie between, or a path of four median depths; null: by age alone",
    )
    own_age_keyframes: int | None = Field(
        default=40,
        ge=1,
        description="so are those at least so many key-frames older, whatever their age; null: by age in seconds only",
    )

    @field_validator("code")
    @classmethod
    def _known_code(cls, code: str) -> str:
        if code == AUTO_CODE or is_code(code):
            return code
        words = (AUTO_CODE, *CODES)
        known = {"name": code, "known": ", ".join(words), "hint": hint(code, words)}
        raise PydanticCustomError(UNKNOWN_NAME, "there is no place code '{name}', only {known}{hint}", known)


class ConsistencyConfig(Settings):
    """Which verified matches are used: those that agree with each other about how two tracks stand to each other."""

    rule: Literal["together", "earlier"] = Field(
        default="together",
        description="together: the largest set that agrees; earlier: the predecessor's, by those before it on the way",
    )
    earlier_m: float = Field(
        default=20.0,
        gt=0,
        description="earlier: matches made at most this far back on the query's way are asked, metres",
    )
    earlier_apart_m: float = Field(
        default=4.0,
        gt=0,
        description="earlier: positions agree within this, metres (indoors the predecessor took 2 over 10)",
    )
    min_support: int = Field(
        default=1, ge=0, description="other matches between the same two tracks that must agree with a match"
    )
    depth_share: float = Field(
        default=0.05, gt=0, description="positions agree within this share of the match's median depth"
    )
    drift: float = Field(default=0.04, ge=0, description="plus this share of the paths between the matches")
    loop_drift: float = Field(
        default=0.15,
        ge=0,
        description="an own loop may correct odometry by this share of the path between, plus depth_share",
    )
    angle_deg: float = Field(default=2.0, gt=0, description="and rotations within this, degrees")
    angle_deg_per_depth: float = Field(
        default=0.6, ge=0, description="plus this for each median depth of path between the matches, degrees"
    )
    scale: float = Field(default=0.1, gt=0, description="and, with one camera, the logarithms of scales within this")
    scale_per_depth: float = Field(default=0.01, ge=0, description="plus this for each median depth of path between")


class OptimisationConfig(Settings):
    """Times of optimisations, and weights of odometry in the graph (thesis section 3.6)."""

    period_keyframes: int = Field(
        default=5, ge=1, description="own key-frames between optimisations that an agent calls for"
    )
    deadline_s: float = Field(default=20.0, gt=0, description="logical time an optimisation may take, seconds")
    closing: bool = Field(default=True, description="optimise once more at the end where something is new")
    odometry_sigma_share: float = Field(
        default=0.003, gt=0, description="1 sigma of an odometry step's position over its length"
    )
    odometry_sigma_depth: float = Field(
        default=0.0005, gt=0, description="plus this share of the key-frame's median depth"
    )
    odometry_sigma_deg: float = Field(default=0.03, gt=0, description="1 sigma of an odometry step's rotation, degrees")
    odometry_sigma_scale: float = Field(
        default=0.005, gt=0, description="one camera: 1 sigma of the log of the scale's drift in an odometry step"
    )
    match_sigma_depth: float = Field(
        default=0.005, gt=0, description="floor of a place match's position sigma, as a share of the median depth"
    )
    match_sigma_deg: float = Field(default=0.1, gt=0, description="floor of a place match's rotation sigma, degrees")
    match_sigma_scale: float = Field(default=0.005, gt=0, description="floor of a place match's log scale sigma")
    updates: bool = Field(
        default=True,
        description="method elected: a match among those whom an optimisation has solved for is an update of what it "
        "changes, no new optimisation",
    )
    positions: bool = Field(
        default=True, description="use positions measured from outside (GPS): elected, multifrontal, two-level, rbcd"
    )
    position_bound: float = Field(
        default=3.0, gt=0, description="a position further off than so many sigma counts less and less: it may be wrong"
    )
    # Members' poses share a frame when an optimisation starts (the task places them), so it can go on from there.
    solver: SolverConfig = SolverConfig(start="warm")


class MergeConfig(Settings):
    """Map merging, Algorithm 1 (thesis section 3.7)."""

    enabled: bool = Field(default=True, description="agents buy each other's maps")
    period_keyframes: int = Field(default=10, ge=1, description="own key-frames between purchases from one agent")
    form: Literal["full", "compact"] = Field(
        default="full",
        description="full: floating-point numbers with descriptors (thesis); compact: a quantised map, sent as changes "
        "between versions",
    )
    max_points: int = Field(default=2000, ge=0, description="map points sold with each key-frame, at most")
    descriptors: bool = Field(default=False, description="compact maps carry the points' descriptors, 32 bytes each")
    point_error: float = Field(
        default=0.005, gt=0, le=0.1, description="median error of a point of a compact map, as a share of its distance"
    )
    pose_error: float = Field(
        default=0.001,
        gt=0,
        le=0.1,
        description="a pose of a map copy is off the owner's by at most this share of the median depth",
    )
    version_keyframes: int = Field(
        default=10, ge=1, description="new key-frames that make a new version of a compact map during the run"
    )
    consistency_m: float | None = Field(
        default=None,
        gt=0,
        description="a map copy that a place match puts this far off is laid on the match (3.3, 3.4), metres "
        "(monocular: tenths of a median depth); the thesis's is 100; null: never",
    )
    redundancy_m: float | None = Field(
        default=None,
        gt=0,
        description="of a map whose old copy agrees with all place matches within this only new key-frames are taken, "
        "metres; the thesis's is 5; null: the newest replaces",
    )
    accuracy_m: float | None = Field(
        default=None,
        gt=0,
        description="a map that no place match agrees with within this is rejected, metres; the thesis's is 5; "
        "null: never",
    )
    accuracy_share: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="so is one of whose place matches, beside those that placed it, less than this share agree; 0: the "
        "thesis's rule only",
    )
    closing_rounds: int = Field(
        default=256, ge=0, description="rounds of purchases at the end, at most; they stop when nothing is new"
    )


class LinkConfig(Settings):
    """Retransmission of messages that get lost. Where none are, none of it happens."""

    repeat_s: float = Field(
        default=0.01,
        gt=0,
        description="a message without an answer is sent again after this, seconds; then after twice that, ...",
    )
    repeat_max_s: float = Field(default=0.64, gt=0, description="longest wait between two such repeats, seconds")
    silence_s: float = Field(
        default=3.0, gt=0, description="a contractor that owes an answer for so long is given up, seconds"
    )
    retries: int = Field(default=2, ge=0, description="how often work that was not delivered is called for again")


class ReputationConfig(Settings):
    """Which agents are trusted (:mod:`maslam.mas.contracts.reputation`)."""

    reliability: float = Field(
        default=0.3,
        ge=0,
        le=1,
        description="an agent is not called below this reliability: its share of delivered contracts",
    )
    consistency: float = Field(
        default=0.45, ge=0, le=1, description="nor when the consistency of its results with others is below this"
    )
    forgetting: float = Field(
        default=0.95, gt=0, le=1, description="weight of an earlier contract after each later one, 0 to 1"
    )
    probe_s: float = Field(default=10.0, gt=0, description="an agent that is not called is probed after this, seconds")


class FaultsConfig(Settings):
    """Faults made on purpose, from the seed: the system is meant to live with them."""

    loss: float = Field(default=0.0, ge=0, lt=1, description="share of messages that never arrive")
    duplicate: float = Field(default=0.0, ge=0, le=1, description="share of messages that arrive twice")
    reorder: float = Field(default=0.0, ge=0, le=1, description="share of messages that are overtaken by later ones")
    delay_s: float = Field(default=0.0, ge=0, description="logical time that every message takes, seconds")
    jitter_s: float = Field(default=0.0, ge=0, description="plus a random time up to this, seconds")
    rate_kbit: float | None = Field(
        default=None,
        gt=0,
        le=1e6,
        description="rate of each agent's radio, which sends one message after another, kbit/s; null: no limit",
    )
    blackout_s: dict[int, float] = Field(
        default={},
        description="agents that no message reaches or leaves for a while, with its beginning in seconds, e.g. {2: 10}",
    )
    blackout_for_s: float = Field(default=10.0, ge=0, le=3600, description="how long that lasts, seconds")
    late_s: dict[int, float] = Field(
        default={},
        description="agents that come late, with their time in seconds, e.g. {2: 10}; their sequence starts then",
    )
    leave_s: dict[int, float] = Field(default={}, description="agents that leave, with their time in seconds")

    @property
    def any(self) -> bool:
        """Whether anything can go wrong."""
        return self != FaultsConfig()


class MasConfig(Settings):
    """Everything that can be set; the resolved values stand in RUN/config.yaml."""

    preset: str = Field(
        default="default",
        description="what the settings start from: maslam (ours), or the thesis's predecessor, default, optimised, "
        "selection",
    )
    policy: str = Field(
        default="query_all",
        description="who decides: query_all (no logic), clustered (the predecessor), logic (Algorithms 2 and 3), "
        "selection (those with Algorithm 4), directory (ours), or an entry point of maslam.policies",
    )
    transport: str = Field(
        default="in_process", description="what carries messages: in_process, or an entry point of maslam.transports"
    )
    seed: int = Field(default=0, ge=0, description="seed of every random choice")
    times: Literal["images", "agent"] = Field(
        default="images", description="times of the trajectories in RUN: the images' own, or from each agent's start"
    )
    step_s: float = Field(default=0.5, gt=0, description="logical time between two steps of the environment, seconds")
    deadline_s: float = Field(default=5.0, gt=0, description="logical time a contract may take, seconds")
    max_message_mb: float = Field(default=64.0, gt=0, description="longest message sent or taken, 2^20 bytes")
    max_messages_a_step: int = Field(
        default=5_000_000, ge=1000, description="more messages in one step are taken for an endless loop"
    )
    ask_again: bool = Field(
        default=True, description="ask agents for places although they were matched within the last gap_keyframes"
    )
    places: PlacesConfig = PlacesConfig()
    relpose: RelPoseConfig = RelPoseConfig()
    consistency: ConsistencyConfig = ConsistencyConfig()
    optimisation: OptimisationConfig = OptimisationConfig()
    merge: MergeConfig = MergeConfig()
    link: LinkConfig = LinkConfig()
    reputation: ReputationConfig = ReputationConfig()
    faults: FaultsConfig = FaultsConfig()
