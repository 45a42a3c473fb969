"""Agents in their own processes' loop: no common clock, no list of all, nobody who says that all is over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from factory import town
from memory_links import MemoryLink, MemoryNetwork

from maslam._replaced import replaced
from maslam.mas.contracts.reputation import Trust
from maslam.mas.errors import MasError
from maslam.mas.evaluation.summary import Summary
from maslam.mas.live import process as process_module
from maslam.mas.live.authority import make_team
from maslam.mas.live.config import LINKS, LiveConfig
from maslam.mas.live.credentials import Credentials
from maslam.mas.live.framing import DrivePhase
from maslam.mas.live.journal import Journal
from maslam.mas.live.neighbours import Neighbours
from maslam.mas.live.one_agent import check_live, digest_of, inputs_of
from maslam.mas.live.process import AgentProcess
from maslam.mas.live.recorded_agent import RecordedAgent
from maslam.mas.live.restart import resume
from maslam.mas.live.team_run import record_team
from maslam.mas.policies.presets import preset

pytest.importorskip("cryptography", reason="the extra 'network' is not installed")
CONFIG = replaced(preset("maslam"), link=LINKS["cable"])
LIVE = LiveConfig(settle_s=1.0, alone_s=3.0)


class Clock:
    """The machine's clock: a test moves it on, and so does each look at it, by 20 us."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        self.now += 2e-5
        return self.now

    def monotonic_ns(self) -> int:
        return round(self.monotonic() * 1e9)


@dataclass
class Team:
    """Agents whose loops take turns, and the clock of their machine."""

    folder: Path
    network: MemoryNetwork
    clock: Clock
    agents: int = 3
    keyframes: int = 14

    def __post_init__(self) -> None:
        self.manifest, self.sequences = town(self.agents, self.keyframes, spacing_m=3.0)
        self.credentials = [
            Credentials(place) for place in make_team(self.folder / "keys", "ours", list(range(self.agents)))
        ]
        self.links: dict[int, MemoryLink] = {}
        self.processes: dict[int, AgentProcess] = {}
        self.ended: dict[int, float] = {}

    def journal(self, me: int) -> Path:
        return self.folder / f"{me}.bin"

    def start(self, me: int) -> None:
        """A process of agent ``me``, which goes on from its journal where there is one."""
        inputs = inputs_of(me, self.manifest, self.manifest.agents[me], self.sequences[me], CONFIG)
        earlier = resume(inputs, self.journal(me))
        journal = Journal(self.journal(me))
        journal.__enter__()
        link = self.links[me] = self.network.link(me)
        neighbours = Neighbours(self.credentials[me], inputs.agent.state.profile.language, link, 10**7)
        agent = RecordedAgent(inputs, journal)
        agent.begin(digest_of(inputs), earlier.now_ns)
        self.processes[me] = AgentProcess(agent, neighbours, CONFIG, LIVE, earlier.now_ns)

    def kill(self, me: int) -> None:
        """As by kill -9: nobody gets a notice but by the link."""
        self.processes.pop(me).agent.journal.__exit__(None, None, None)
        self.network.leave(self.links[me])

    def go_on(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        end = self.clock.now + seconds
        while self.processes and self.clock.now < end and not until():
            self.clock.now += 0.02
            for me in sorted(self.processes):
                if self.processes[me].step(lambda _: None):
                    continue
                self.ended[me] = self.clock.now
                self.processes[me].leave()
                self.kill(me)

    def run_folder(self) -> Summary:
        paths = [self.journal(me) for me in range(self.agents)]
        return record_team(self.manifest, self.sequences, CONFIG, paths, self.folder / "run", 1.0)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(process_module, "time", clock)
    monkeypatch.setattr("maslam.mas.live.neighbours.time", clock)
    return clock


def test_agents_meet_join_and_end_by_themselves(tmp_path: Path, clock: Clock) -> None:
    team = Team(tmp_path, MemoryNetwork(), clock)
    for me in range(3):
        team.start(me)
        clock.now += 0.7  # no two clocks show the same
    neighbours = {me: process.neighbours for me, process in team.processes.items()}
    team.go_on(120)
    assert sorted(team.ended) == [0, 1, 2]
    assert max(team.ended.values()) < 115.0
    for a, b in permutations(range(3), 2):
        carried = sum(len(data) for *ends, data in team.network.sent if ends == [a, b])
        sent, received = neighbours[a].out[b], neighbours[b].into[a]
        assert sent.data_bytes + sent.control_bytes + sent.greeting_bytes == carried
        assert 0 < sent.message_bytes < sent.data_bytes and 0 < sent.control_bytes < 500
        # The last word of who goes last finds nobody.
        assert (sent.message_bytes, sent.data_bytes) == (received.message_bytes, received.data_bytes)
    summary = team.run_folder()
    assert summary.groups == [[0, 1, 2]] and summary.matches.false_accepted == 0
    assert summary.ate_rmse_m.mean_agents < 0.2


def test_frames_may_be_lost(tmp_path: Path, clock: Clock) -> None:
    rng = np.random.default_rng(5)
    team = Team(tmp_path, MemoryNetwork(lambda *_: rng.random() < 0.3), clock)
    for me in range(3):
        team.start(me)
    team.go_on(200)
    assert sorted(team.ended) == [0, 1, 2]
    summary = team.run_folder()
    assert summary.groups == [[0, 1, 2]] and summary.matches.false_accepted == 0


def test_answers_may_take_longer_than_a_step(tmp_path: Path, clock: Clock) -> None:
    """Half a second one way, as long as a step: what an agent says of how far it is, is acknowledged a step later."""
    team = Team(tmp_path, MemoryNetwork(delay_s=0.5, now_s=lambda: clock.now), clock)
    for me in range(3):
        team.start(me)
    team.go_on(120)
    assert sorted(team.ended) == [0, 1, 2]
    summary = team.run_folder()
    assert summary.groups == [[0, 1, 2]] and summary.matches.false_accepted == 0


def test_two_that_never_exchange_a_frame_are_joined_by_the_third(tmp_path: Path, clock: Clock) -> None:
    """What names an agent that one has not met is no lie: nobody loses trust, and nobody waits in vain."""
    team = Team(tmp_path, MemoryNetwork(lambda sender, recipient, data: {sender, recipient} == {0, 2}), clock)
    for me in range(3):
        team.start(me)
    agents = {me: process.agent.agent for me, process in team.processes.items()}
    team.go_on(120)
    drive_s = max(sequence.keyframe_stamps_ns[-1] for sequence in team.sequences) / 1e9
    assert sorted(team.ended) == [0, 1, 2] and max(team.ended.values()) < 100.0 + drive_s + 15.0
    assert agents[0].state.profile.others == agents[2].state.profile.others == (1,)
    trust = {r.trust(a) for agent in agents.values() for r in [agent.context.reputation] for a in r.records}
    assert trust == {Trust.GOOD} and not any(
        r.refused for a in agents.values() for r in a.context.reputation.records.values()
    )
    summary = team.run_folder()
    assert summary.groups == [[0, 1, 2]] and summary.matches.false_accepted == 0


def test_two_teams_on_one_network_do_not_disturb_each_other(tmp_path: Path, clock: Clock) -> None:
    """The same numbers, the same team's name, two authorities: each is what it is alone, and ends when it would."""
    network = MemoryNetwork()
    teams = [Team(tmp_path / name, network, clock, agents=2) for name in ("ours", "theirs")]
    for team in teams:
        for me in range(2):
            team.start(me)
    while any(team.processes for team in teams) and clock.now < 160.0:
        for team in teams:
            team.go_on(0.02)
    for team in teams:
        assert sorted(team.ended) == [0, 1] and max(team.ended.values()) < 120.0
        summary = team.run_folder()
        assert summary.groups == [[0, 1]] and summary.matches.false_accepted == 0


def test_a_late_agent_joins_those_who_wait(tmp_path: Path, clock: Clock) -> None:
    """Agent 2 comes while the others, whose drives are over, still settle."""
    team = Team(tmp_path, MemoryNetwork(), clock)
    team.start(0)
    team.start(1)
    team.go_on(60, lambda: team.processes[0].neighbours.phase is not DrivePhase.DRIVING)
    team.start(2)
    team.go_on(120)
    assert sorted(team.ended) == [0, 1, 2]
    assert team.run_folder().groups == [[0, 1, 2]]


def test_an_agent_that_was_killed_goes_on_from_its_journal(tmp_path: Path, clock: Clock) -> None:
    """Its key-frames, matches and promises are those that it had; the team is one in the end."""
    team = Team(tmp_path, MemoryNetwork(), clock)
    for me in range(3):
        team.start(me)
    team.go_on(3.0)
    before = team.processes[1].agent.inputs
    seen, accepted = before.seen, set(before.agent.state.accepted)
    assert 0 < seen < team.keyframes and accepted
    team.kill(1)
    team.go_on(1.5)
    team.start(1)
    again = team.processes[1].agent.inputs
    assert again.seen == seen and again.agent.state.accepted == accepted
    assert np.array_equal(again.agent.state.poses, before.agent.state.poses)
    team.go_on(120)
    assert sorted(team.ended) == [0, 1, 2]
    summary = team.run_folder()
    assert summary.groups == [[0, 1, 2]] and summary.keyframes == 3 * team.keyframes


def test_who_never_comes_back_keeps_nobody_waiting(tmp_path: Path, clock: Clock) -> None:
    team = Team(tmp_path, MemoryNetwork(), clock)
    for me in range(3):
        team.start(me)
    team.go_on(3.0)
    team.kill(2)
    team.go_on(60)
    assert sorted(team.ended) == [0, 1]
    assert [0, 1] in team.run_folder().groups or [0, 1, 2] in team.run_folder().groups


def test_an_agent_alone_waits_a_while_and_ends(tmp_path: Path, clock: Clock) -> None:
    team = Team(tmp_path, MemoryNetwork(), clock, agents=2)
    team.start(0)
    team.go_on(60)
    least_s = max(team.sequences[0].keyframe_stamps_ns[-1] / 1e9, LIVE.alone_s)
    assert 100 + least_s <= team.ended[0] <= 100 + least_s + 4.0


def test_a_message_in_anothers_name_changes_nothing(tmp_path: Path, clock: Clock) -> None:
    """Agent 1 has its seal, and writes messages as if they were agent 2's."""
    from maslam.mas.protocol.messages import GroupNotice, Message, encode

    team = Team(tmp_path, MemoryNetwork(), clock)
    for me in range(3):
        team.start(me)
    team.go_on(0.3)
    entries = team.journal(0).stat().st_size
    forged = encode(Message(2, 0, None, GroupNotice((0, 1, 2))))
    team.processes[1].neighbours.send(0, forged)
    team.processes[1].neighbours.flush()
    team.processes[0].step(lambda _: None)
    assert team.processes[0].agent.agent.state.group == {0}
    assert forged not in team.journal(0).read_bytes()[entries:]


def test_what_a_network_does_not_know_is_refused() -> None:
    with pytest.raises(MasError, match="only a simulation makes faults"):
        check_live(replaced(CONFIG, faults=replaced(CONFIG.faults, loss=0.1)))
    with pytest.raises(MasError, match="policy clustered"):
        check_live(preset("predecessor"))
