"""What a team on this machine plays: sequences that were made before, or images that live agents track."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import UsageError
from ..live.options import PLAYED
from ..pipeline.preprocess_options import SECTION, PreprocessSettings

if TYPE_CHECKING:
    from maslam._kernels import TypedKernel
    from maslam.descriptors.base import PlaceDescriptor
    from maslam.frontend.datasets.base import ImageSequence
    from maslam.mas.manifest import Manifest
    from maslam.mas.sequence import AgentSequence


class PlayedTeam(ABC):
    """The agents' inputs. ``source``: what each agent's command is given; ``counted``: the number in an agent's lines
    of JSON that says how far it is, ``totals``: what that is in the end; ``settings``: sections of its settings file
    beside those of the run."""

    source: Path
    counted: str
    totals: Sequence[int]
    settings: dict[str, Any]

    @property
    @abstractmethod
    def kernels(self) -> Sequence[TypedKernel]:
        """Compiled functions that the agents use."""

    @abstractmethod
    def arguments(self, agent: int) -> tuple[str, ...]:
        """More of an agent's command line."""

    @abstractmethod
    def played(self, journals: Sequence[Path]) -> tuple[Manifest, list[AgentSequence]]:
        """The agents' sequences, when all is over."""

    def said(self, folders: Sequence[Path]) -> list[str]:
        """Lines on what the agents wrote into their folders."""
        return []


class RecordedTeam(PlayedTeam):
    """A SEQS folder."""

    counted = "seen"

    def __init__(self, folder: Path) -> None:
        from maslam.mas.sequence import load_sequences

        self.source, self.settings = folder, {}
        self._loaded = load_sequences(folder)
        self.totals = [len(sequence.keyframe_stamps_ns) for sequence in self._loaded[1]]

    @property
    def kernels(self) -> Sequence[TypedKernel]:
        """See :attr:`PlayedTeam.kernels`."""
        from maslam.mas.kernels import agent_kernels

        return agent_kernels(len(self.totals))

    def arguments(self, agent: int) -> tuple[str, ...]:
        """See :meth:`PlayedTeam.arguments`."""
        return ()

    def played(self, journals: Sequence[Path]) -> tuple[Manifest, list[AgentSequence]]:
        """See :meth:`PlayedTeam.played`."""
        return self._loaded


class LiveTeam(PlayedTeam):
    """The image sequences of a source, each played at its rate to an agent that tracks it."""

    counted = "time_s"

    def __init__(self, source: Path, settings: PreprocessSettings, speed: float) -> None:
        from ..pipeline.preprocess import open_source

        check_live_settings(settings)
        self._model: PlaceDescriptor
        self._model, dataset = open_source(source, settings)
        self.source, self._rig, self._name = source, settings.rig, str(settings.model)
        self._sequences: list[ImageSequence] = list(dataset.sequences)
        self._root, self._kind = dataset.root, dataset.kind
        self.totals = [int((s.stamps_ns[-1] - s.stamps_ns[0]) / 1e9) + 1 for s in self._sequences]
        self.settings = {SECTION: settings.odometry.model_dump(mode="json")}
        self.manifest = self._manifest(speed)

    @property
    def kernels(self) -> Sequence[TypedKernel]:
        """See :attr:`PlayedTeam.kernels`."""
        from maslam.frontend.kernels import odometry_kernels
        from maslam.mas.kernels import agent_kernels

        return (*odometry_kernels({s.rig.kind for s in self._sequences}), *agent_kernels(len(self.totals)))

    def arguments(self, agent: int) -> tuple[str, ...]:
        """See :meth:`PlayedTeam.arguments`."""
        rig = ("--rig", self._rig) if self._rig else ()
        return ("--live", PLAYED, "--sequence", self._sequences[agent].name, "--model", self._name, *rig)

    def played(self, journals: Sequence[Path]) -> tuple[Manifest, list[AgentSequence]]:
        """See :meth:`PlayedTeam.played`: the key-frames and frames in the agents' journals."""
        from maslam._replaced import replaced

        from ..live.played import played_sequence

        made = [
            played_sequence(me, images, journal, self._model)
            for me, (images, journal) in enumerate(zip(self._sequences, journals, strict=True))
        ]
        agents = tuple(
            replaced(
                entry,
                keyframes=len(sequence.keyframe_stamps_ns),
                tracks=len(sequence.tracks),
                start_ns=sequence.start_ns,
                lost=sequence.lost,
            )
            for entry, sequence in zip(self.manifest.agents, made, strict=True)
        )
        return replaced(self.manifest, agents=agents), made

    def said(self, folders: Sequence[Path]) -> list[str]:
        """See :meth:`PlayedTeam.said`: what became of each agent's frames."""
        from ..live.agent import FIGURES
        from ..live.tracker import LiveFigures
        from .live_command import figures_line

        found = [LiveFigures.from_json((folder / FIGURES).read_text(encoding="utf-8")) for folder in folders]
        return [f"agent {me}: {figures_line(one)}" for me, one in enumerate(found)]

    def _manifest(self, speed: float) -> Manifest:
        from maslam.mas.live.credentials import name_of_agent
        from maslam.mas.manifest import AgentEntry, CameraEntry, Manifest

        from ..pipeline.descriptor_entry import descriptor_entry

        agents = tuple(
            AgentEntry(
                name=name_of_agent(me),
                sequence=images.name,
                first_frame=0,
                frames=len(images),
                keyframes=0,
                tracks=0,
                start_ns=int(images.stamps_ns[0]),
                camera=CameraEntry.from_rig(images.rig),
            )
            for me, images in enumerate(self._sequences)
        )
        return Manifest(
            source=str(self._root.resolve()),
            kind=self._kind,
            scale="metric" if any(entry.metric for entry in agents) else "arbitrary",
            descriptor=descriptor_entry(self._model),
            agents=agents,
            settings={**self.settings, "model": self._name, "rig": self._rig, "live": True, "speed": speed},
        )


def check_live_settings(settings: PreprocessSettings) -> None:
    """``UsageError`` where something is set that live agents do not know."""
    from maslam.frontend.datasets.reading_config import ReadingConfig
    from maslam.frontend.recording_config import RecordingConfig

    from ..common.found_positions import NO_POSITIONS

    if settings.agents is not None or settings.overlap:
        raise UsageError("--live: each sequence of SRC is an agent's; none is cut for --agents")
    unknown = {
        "--dataset": settings.dataset is not None,
        "--provider": settings.provider != "CPU",
        "--vocabulary": settings.vocabulary is not None,
        "--recording.*": settings.recording not in (None, RecordingConfig()),
        "--images.*": settings.reading not in (None, ReadingConfig()),
        "--gps": settings.positions != NO_POSITIONS,
    }
    wrong = [name for name, is_set in unknown.items() if is_set]
    if wrong:
        raise UsageError(f"--live: agents that track while they drive do not know {', '.join(wrong)}")
