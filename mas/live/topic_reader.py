"""Topics of a team as somebody reads them who has a certificate of it: each sample is proven to be of its agent."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .credentials import Credentials, CredentialsError
from .team_pose import TeamMap, TeamPose
from .topics import MapPart, Topic, TopicError, TopicSample, decode_map_part, decode_pose, decode_sample


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
class _Listened:
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
        self._heard: dict[tuple[int, Topic], _Listened] = {}

    def take(self, topic: Topic, agent: int, data: bytes) -> AgentPose | AgentMap | None:
        """What a sample says, in the name of ``agent``; None where it is not believed, came before, is not the last
        part of a map, or the agent's certificate is not known yet."""
        self._credentials.revocations.refresh()
        try:
            sample = decode_sample(data)
            heard = self._heard.get((agent, topic), _Listened())
            if (sample.began_ns, sample.number) <= heard.last:
                return None
            if not sample.certificate and not heard.certificate:
                return None  # it comes within a second
            heard.certificate = self._proven(topic, agent, sample, sample.certificate or heard.certificate)
            heard.last = (sample.began_ns, sample.number)
            self._heard[agent, topic] = heard
            if topic is Topic.POSE:
                return AgentPose(agent, decode_pose(sample.body))
            return self._whole(agent, heard, sample)
        except (TopicError, CredentialsError) as error:
            self.refused, self.reason = self.refused + 1, f"agent {agent}: {error}"
            return None

    def _proven(self, topic: Topic, agent: int, sample: TopicSample, certificate: bytes) -> bytes:
        """The certificate, with which the agent signed the sample."""
        self._credentials.check_valid(certificate)
        if not self._credentials.signed_by(agent, certificate, sample.signature, sample.digest(topic, agent)):
            raise TopicError("a signature that is not its own")
        return certificate

    def _whole(self, agent: int, heard: _Listened, sample: TopicSample) -> AgentMap | None:
        """The map that a part completes. Parts of a newer version take the place of those of an older one."""
        part = decode_map_part(sample.body)
        if heard.version != (sample.began_ns, part.version):
            heard.version, heard.parts = (sample.began_ns, part.version), {}
        heard.parts[part.part] = part
        if len(heard.parts) < part.parts:
            return None
        parts = [heard.parts[index] for index in sorted(heard.parts)]
        heard.parts = {}
        points = np.concatenate([one.points for one in parts]).astype(np.float64)
        owners = np.concatenate([one.owners for one in parts])
        return AgentMap(agent, TeamMap(part.frame, points, owners), part.total)
