"""Topics of a team as somebody reads them who has a certificate of it: each sample is proven to be of its agent."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .credentials import Credentials, CredentialsError
from .team_pose import TeamMap, TeamPose
from .topics import LiveTopic, MapPart, TopicError, TopicSample, decode_map_part, decode_pose, decode_sample


@dataclass(frozen=True, eq=False)
class AgentPose:
    """Agent ``agent`` says where it is."""

    agent: int
    pose: TeamPose


@dataclass(frozen=True, eq=False)
class AgentMap:
    """Agent ``agent`` gives its map of the team out. ``total``: points of it; one with more than are given is thinned
    evenly."""

    agent: int
    map: TeamMap
    total: int


@dataclass
class _ReadStream:
    """One topic of one agent: the certificate, the last sample's process and number, parts of the newest map."""

    certificate: bytes = b""
    last: tuple[int, int] = (-(2**63), -1)
    version: tuple[int, int] | None = None
    parts: dict[int, MapPart] = field(default_factory=dict)


class TopicReader:
    """``take`` what comes. ``refused``: samples that were not believed; ``reason``: why the last one was not."""

    def __init__(self, credentials: Credentials) -> None:
        self.refused, self.reason = 0, ""
        self._credentials = credentials
        self._received: dict[tuple[int, LiveTopic], _ReadStream] = {}

    def take(self, topic: LiveTopic, agent: int, data: bytes) -> AgentPose | AgentMap | None:
        """What a sample says, in the name of ``agent``; None where it is not believed, came before, is not the last
        part of a map, or the agent's certificate is not known yet."""
        self._credentials.revocations.refresh()
        try:
            sample = decode_sample(data)
            stream = self._received.get((agent, topic), _ReadStream())
            if (sample.began_ns, sample.number) <= stream.last:
                return None
            if not sample.certificate and not stream.certificate:
                return None  # it comes within a second
            stream.certificate = self._proven(topic, agent, sample, sample.certificate or stream.certificate)
            stream.last = (sample.began_ns, sample.number)
            self._received[agent, topic] = stream
            if topic is LiveTopic.POSE:
                return AgentPose(agent, decode_pose(sample.body))
            return self._whole(agent, stream, sample)
        except (TopicError, CredentialsError) as error:
            self.refused, self.reason = self.refused + 1, f"agent {agent}: {error}"
            return None

    def _proven(self, topic: LiveTopic, agent: int, sample: TopicSample, certificate: bytes) -> bytes:
        """The certificate, with which the agent signed the sample."""
        self._credentials.check_valid(certificate)
        if not self._credentials.signed_by(agent, certificate, sample.signature, sample.digest(topic, agent)):
            raise TopicError("a signature that is not its own")
        return certificate

    def _whole(self, agent: int, stream: _ReadStream, sample: TopicSample) -> AgentMap | None:
        """The map that a part completes. Parts of a newer version take the place of those of an older one."""
        part = decode_map_part(sample.body)
        if stream.version != (sample.began_ns, part.version):
            stream.version, stream.parts = (sample.began_ns, part.version), {}
        stream.parts[part.part] = part
        if len(stream.parts) < part.parts:
            return None
        parts = [stream.parts[index] for index in sorted(stream.parts)]
        stream.parts = {}
        points = np.concatenate([one.points for one in parts]).astype(np.float64)
        owners = np.concatenate([one.owners for one in parts])
        return AgentMap(agent, TeamMap(part.frame, points, owners), part.total)
