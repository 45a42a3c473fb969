"""The journal of an agent: it makes the same agent again, and notices where it does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factory import town

from maslam._replaced import replaced
from maslam.mas.agent import Agent
from maslam.mas.contracts.effects import Effects
from maslam.mas.live.journal import EntryKind, Journal, JournalEntry, JournalError, read_journal
from maslam.mas.live.one_agent import digest_of, inputs_of
from maslam.mas.live.recorded_agent import AgentInputs, RecordedAgent, replay
from maslam.mas.live.restart import resume
from maslam.mas.live.team_run import record_team
from maslam.mas.policies.presets import preset

STEPS = 16


def inputs(me: int, seed: int = 0, preset_name: str = "maslam") -> AgentInputs:
    """An agent of two, which knows nobody."""
    manifest, sequences = town(2, 12, seed, spacing_m=1.5)
    return inputs_of(me, manifest, manifest.agents[me], sequences[me], preset(preset_name))


def play(recorded: list[RecordedAgent], steps: int = STEPS) -> None:
    """Two agents meet, drive, and exchange messages at once."""
    mail: list[Effects] = []
    for me, agent in enumerate(recorded):
        agent.begin(digest_of(agent.inputs), 0)
        agent.meet(1 - me, 0)
    for step in range(steps):
        now_ns = step * 500_000_000
        for agent in recorded:
            if agent.inputs.seen < len(agent.inputs.keyframes):
                agent.observe(now_ns)
            elif not agent.agent.context.closing:
                agent.finish(now_ns)
            mail.append(agent.tick(now_ns))
        while mail:
            for message in mail.pop(0).messages:
                mail.append(recorded[message.recipient].handle(message, now_ns))


@pytest.fixture(scope="module")
def journals(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("journals")
    paths = [folder / f"{me}.bin" for me in range(2)]
    with Journal(paths[0]) as one, Journal(paths[1]) as other:
        play([RecordedAgent(inputs(0), one), RecordedAgent(inputs(1), other)])
    return paths


def poses_of(agent: Agent) -> np.ndarray:
    return np.array(agent.state.poses)


def test_an_agent_made_from_its_journal_is_the_same(journals: list[Path], tmp_path: Path) -> None:
    paths = [tmp_path / f"{me}.bin" for me in range(2)]
    with Journal(paths[0]) as one, Journal(paths[1]) as other:
        first = [RecordedAgent(inputs(0), one), RecordedAgent(inputs(1), other)]
        play(first)
    for me in range(2):
        again = inputs(me)
        resumed = resume(again, paths[me])
        assert resumed.begun == 1 and resumed.now_ns == (STEPS - 1) * 500_000_000
        assert again.sent == first[me].inputs.sent != 0 and again.seen == 12
        assert np.array_equal(poses_of(again.agent), poses_of(first[me].agent))
        assert again.agent.state.accepted == first[me].agent.state.accepted != set()
        assert again.agent.state.group == {0, 1}


def test_what_a_crash_tore_off_is_cut_away(journals: list[Path], tmp_path: Path) -> None:
    data = journals[0].read_bytes()
    whole = list(read_journal(journals[0]))
    torn = tmp_path / "torn.bin"
    for cut in (0, 5, 17, 18, 40, len(data) // 2, len(data) - 1):
        torn.write_bytes(data[:cut])
        kept = list(read_journal(torn))
        assert kept == whole[: len(kept)] and len(kept) < len(whole)
        with Journal(torn) as journal:
            journal.append(JournalEntry(EntryKind.TICK, 7, b"", 0))
        assert list(read_journal(torn)) == [*kept, JournalEntry(EntryKind.TICK, 7, b"", 0)]


def test_a_damaged_entry_ends_the_journal(journals: list[Path], tmp_path: Path) -> None:
    data = bytearray(journals[0].read_bytes())
    data[len(data) // 2] ^= 1
    damaged = tmp_path / "damaged.bin"
    damaged.write_bytes(data)
    kept = list(read_journal(damaged))
    assert kept == list(read_journal(journals[0]))[: len(kept)]


def test_another_file_is_no_journal(tmp_path: Path) -> None:
    path = tmp_path / "journal.bin"
    path.write_bytes(b"something else altogether")
    with pytest.raises(JournalError, match=r"journal\.bin: not the journal"):
        list(read_journal(path))


def test_other_settings_or_another_sequence_are_found_out(journals: list[Path]) -> None:
    with pytest.raises(JournalError, match="another sequence, or written with other settings"):
        resume(inputs(0, seed=1), journals[0])
    with pytest.raises(JournalError, match="another sequence, or written with other settings"):
        resume(inputs(1), journals[0])
    with pytest.raises(JournalError, match="another sequence, or written with other settings"):
        resume(inputs(0, preset_name="default"), journals[0])


def test_an_agent_that_acts_otherwise_is_found_out(journals: list[Path]) -> None:
    """A message that is missing from the journal makes another agent, which the checksums tell."""
    entries = list(read_journal(journals[0]))
    at = next(i for i, e in enumerate(entries) if e.kind is EntryKind.MESSAGE)
    with pytest.raises(JournalError, match="sends other messages"):
        list(replay(inputs(0), entries[:at] + entries[at + 1 :], "journal.bin"))


def test_entries_of_what_is_not_there_are_errors(journals: list[Path]) -> None:
    entries = list(read_journal(journals[0]))
    wrong = replace(next(e for e in entries if e.kind is EntryKind.OBSERVE), data=b"\xff\xff\0\0", sent=0)
    with pytest.raises(JournalError, match="observe of what is not there"):
        list(replay(inputs(0), [wrong], "journal.bin"))


def test_a_run_folder_is_made_from_journals(journals: list[Path], tmp_path: Path) -> None:
    """With the bytes that were sent, and errors against the truth."""
    manifest, sequences = town(2, 12, spacing_m=1.5)
    config = preset("maslam")
    summary = record_team(manifest, sequences, config, journals, tmp_path / "run", 1.0)
    assert summary.groups == [[0, 1]] and summary.matches.accepted >= 1 and summary.matches.false_accepted == 0
    rows = (tmp_path / "run" / "traffic.csv").read_text().splitlines()[1:]
    assert len(rows) == summary.traffic["total"].messages > 20
    assert sum(int(row.rsplit(",", 1)[1]) for row in rows) == summary.traffic["total"].wire_bytes
    assert (tmp_path / "run" / "agent_01" / "trajectory.tum").is_file()
    other = replaced(config, places=replaced(config.places, max_points=50, first_points=0))
    with pytest.raises(JournalError):
        record_team(manifest, sequences, other, journals, tmp_path / "other", 1.0)
    assert not (tmp_path / "other").exists()
