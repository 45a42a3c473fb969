"""From images to maps: preprocess, run, and both in one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from maslam.descriptors.choice import DescriptorLike
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets.readers import ReaderLike
from maslam.mas import simulation
from maslam.mas.config import MasConfig
from maslam.mas.kernels import agent_kernels
from maslam.mas.output.run_folder import check_out
from maslam.mas.policies.foreign import PolicyLike
from maslam.mas.policies.presets import check_policy
from maslam.mas.policies.presets import preset as preset_named
from maslam.mas.transport.choice import TransportLike, check_transport
from maslam.tools.common.compiling import compile_for
from maslam.tools.common.found_positions import DEFAULT_SIGMA_M
from maslam.tools.common.progress import CallbackProgress, counter
from maslam.tools.common.writing import writing
from maslam.tools.pipeline import preprocess as images
from maslam.tools.pipeline import slam as chain
from maslam.tools.pipeline.earlier_result import check_same_run, of_manifest
from maslam.tools.pipeline.predecessor import sequences_for
from maslam.tools.pipeline.preprocess_options import DEFAULT_OVERLAP, SECTIONS
from maslam.tools.pipeline.run import DEFAULT_PRESET, earlier_run, joined

from .common import (
    PathLike,
    ProgressCallback,
    Settings,
    changed,
    nested,
    on_one_thread,
    positions_of,
    preprocess_settings,
)
from .results import Run, Sequences


@on_one_thread
def preprocess(
    source: PathLike,
    out: PathLike,
    *,
    agents: int | None = None,
    overlap: int = DEFAULT_OVERLAP,
    rig: RigKind | str | None = None,
    dataset: str | None = None,
    readers: Sequence[ReaderLike] = (),
    descriptor: DescriptorLike | str | Path = "default",
    provider: str = "CPU",
    vocabulary: PathLike | None = None,
    gps: PathLike | None = None,
    gps_offset_s: float = 0.0,
    gps_sigma_m: float = DEFAULT_SIGMA_M,
    gps_antenna_m: tuple[float, float, float] | None = None,
    settings: Settings | None = None,
    workers: int = 1,
    overwrite: bool = False,
    progress: ProgressCallback | None = None,
) -> Sequences:
    """Turn images into agent sequences: odometry, map points and place vectors of each agent, in a folder.

    What is made of a sequence is kept in the folder and used again while images, settings and code are the same.

    Args:
        source: a folder of images or a recording, as :func:`maslam.open_dataset` reads it.
        out: folder for the agent sequences.
        agents: cut one sequence into blocks for so many agents; None makes one agent of each sequence.
        overlap: key-frames that a block takes from its neighbours (the thesis: 3). Both agents then have these images,
            and pairs of one and the same image are no evidence for a match.
        rig: ``"mono"``, ``"stereo"`` or ``"rgbd"``: use only this much of the sensors.
        dataset, readers: how ``source`` is read, as in :func:`maslam.open_dataset`.
        descriptor: a shipped place descriptor by name, an ONNX file with its card beside it, an entry point of
            ``maslam.descriptors``, or your own (:class:`maslam.Descriptor`).
        provider: where onnxruntime runs it.
        vocabulary: file of ORB words; None takes the one shipped.
        gps, gps_offset_s, gps_sigma_m, gps_antenna_m: a file of positions (or a folder with one for each agent; None:
            ``gps.csv``, ``gps.nmea`` or ``gps.gpx`` beside the images, or a bag's NavSatFix), what to add to its times,
            its noise where the file has none, and the antenna's place in the camera's frame.
        settings: of the odometry, ``{"odometry.features.tracks": 500}``, of what is read, ``{"recording.stride": 2}``,
            and how, ``{"images.masks": "masks"}``.
        workers: processes. More than one needs a script that calls this under ``if __name__ == "__main__":``.
        overwrite: replace what ``out`` holds of another source or with other settings, which is refused otherwise.
        progress: called with title, steps done and all steps, now and then.

    Raises:
        MaslamError: nothing that can be used, an unknown setting, a folder with other files in it.
    """
    content = nested(settings)
    positions = positions_of(gps, gps_offset_s, gps_sigma_m, gps_antenna_m)
    told = preprocess_settings(
        content, agents, overlap, rig, dataset, readers, descriptor, provider, vocabulary, workers, overwrite, positions
    )
    images.preprocess(Path(source), Path(out), told, CallbackProgress(progress))
    return Sequences.load(out)


@on_one_thread
def run(
    sequences: Sequences | PathLike,
    out: PathLike,
    *,
    preset: str | MasConfig = DEFAULT_PRESET,
    seed: int | None = None,
    settings: Settings | None = None,
    policy: PolicyLike | str | None = None,
    transport: TransportLike | str | None = None,
    onto: Run | PathLike | None = None,
    overwrite: bool = False,
    progress: ProgressCallback | None = None,
) -> Run:
    """Run the multi-agent system on agent sequences and write the RUN folder, whole or not at all.

    The same sequences, settings and seed give the same bytes in every file but ``timing.json``.

    Args:
        sequences: what :func:`maslam.preprocess` gave, or its folder.
        out: folder for the results; an earlier run of the same sequences and settings in it is replaced.
        preset: ``"predecessor"``, ``"default"``, ``"optimised"``, ``"selection"``, ``"maslam"``, or all settings as one
            value: of :func:`maslam.preset`, or an earlier ``run.config``.
        seed: of every random choice; None leaves the preset's, 0.
        settings: some settings by name, ``{"places.threshold": 0.8}``; ``maslam run --help`` lists them.
        policy: your own (:class:`maslam.Policy`; each agent gets a copy), or one by name.
        transport: your own (:class:`maslam.Transport`), or one by name.
        onto: an earlier run, or its folder: its agents answer, and the new ones find themselves in its map.
        overwrite: replace a run in ``out`` of other sequences or with other settings, which is refused otherwise.
        progress: called with title, steps done and all steps.

    Raises:
        MaslamError: a folder that is not of agent sequences, an unknown setting, somebody else's files in ``out``.
    """
    config = _config(preset, seed, nested(settings), policy, transport)
    check_out(Path(out))
    earlier = earlier_run(_folder(onto), Path(out))
    tasks = CallbackProgress(progress)
    folder = sequences.folder if isinstance(sequences, Sequences) else Path(sequences)
    manifest, loaded = sequences_for(folder, Path(out), tasks, overwrite)
    whole = joined(earlier, manifest)
    if not overwrite:
        check_same_run(Path(out), config, of_manifest(whole))
    compile_for(agent_kernels(len(whole.agents)), tasks)
    told = counter(tasks, "agents")
    with writing(Path(out)):
        simulation.run(manifest, loaded, config, Path(out), told, _object(policy), _object(transport), earlier)
    return Run.load(out)


@on_one_thread
def slam(
    source: PathLike,
    out: PathLike,
    *,
    agents: int | None = None,
    overlap: int = DEFAULT_OVERLAP,
    rig: RigKind | str | None = None,
    dataset: str | None = None,
    readers: Sequence[ReaderLike] = (),
    descriptor: DescriptorLike | str | Path = "default",
    provider: str = "CPU",
    vocabulary: PathLike | None = None,
    gps: PathLike | None = None,
    gps_offset_s: float = 0.0,
    gps_sigma_m: float = DEFAULT_SIGMA_M,
    gps_antenna_m: tuple[float, float, float] | None = None,
    preset: str | MasConfig = DEFAULT_PRESET,
    seed: int | None = None,
    settings: Settings | None = None,
    policy: PolicyLike | str | None = None,
    transport: TransportLike | str | None = None,
    onto: Run | PathLike | None = None,
    workers: int = 1,
    overwrite: bool = False,
    progress: ProgressCallback | None = None,
) -> Run:
    """From a folder of images to one map and a report: :func:`maslam.preprocess`, :func:`maslam.run`, and the page
    ``out/report/index.html``. The same files as of the command ``maslam slam``.

    Args:
        source: a folder of images or a recording, as :func:`maslam.open_dataset` reads it.
        out: folder for the results; ``out/sequences`` holds the agent sequences.
        agents, overlap, rig, dataset, readers, descriptor, provider, vocabulary, gps, gps_offset_s, gps_sigma_m,
            gps_antenna_m, workers, overwrite: as in :func:`maslam.preprocess`.
        preset, seed, policy, transport, onto: as in :func:`maslam.run`.
        settings: of the agents, ``{"places.threshold": 0.8}``, of the odometry,
            ``{"odometry.features.tracks": 500}``, of what is read, ``{"recording.stride": 2}``, and how,
            ``{"images.masks": "masks"}``.
        progress: called with title, steps done and all steps, now and then.

    Raises:
        MaslamError: as of :func:`maslam.preprocess` and :func:`maslam.run`.
    """
    content = nested(settings)
    config = _config(preset, seed, {k: v for k, v in content.items() if k not in SECTIONS}, policy, transport)
    own = {key: content[key] for key in SECTIONS if key in content}
    positions = positions_of(gps, gps_offset_s, gps_sigma_m, gps_antenna_m)
    told = preprocess_settings(
        own, agents, overlap, rig, dataset, readers, descriptor, provider, vocabulary, workers, overwrite, positions
    )
    shown = CallbackProgress(progress)
    given = (_object(policy), _object(transport), _folder(onto))
    chain.slam(Path(source), Path(out), told, config, shown, *given)
    return Run.load(out)


def _config(
    preset: str | MasConfig,
    seed: int | None,
    settings: dict[str, Any],
    policy: PolicyLike | str | None,
    transport: TransportLike | str | None,
) -> MasConfig:
    """Everything that is set; names that are not known are refused before any work."""
    base = preset if isinstance(preset, MasConfig) else preset_named(preset)
    named = {"seed": seed, "policy": _name(policy), "transport": _name(transport)}
    config = changed(base, {**settings, **{key: value for key, value in named.items() if value is not None}})
    if _object(policy) is None:
        check_policy(config.policy)
    if _object(transport) is None:
        check_transport(config.transport)
    return config


def _folder(onto: Run | PathLike | None) -> Path | None:
    return onto.folder if isinstance(onto, Run) else None if onto is None else Path(onto)


def _name(given: object) -> str | None:
    return given if isinstance(given, str) else None


def _object(given: Any) -> Any:
    """A user's own; None where it is given by name or not at all."""
    return None if isinstance(given, str) else given
