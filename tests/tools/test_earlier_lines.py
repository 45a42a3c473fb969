"""What the console and the report say of a run that was made onto an earlier one."""

from __future__ import annotations

from maslam.tools.report.earlier_lines import earlier_lines, earlier_sections

FOUND = {
    "agents": 2,
    "frame": [0, 0],
    "in_frame": [2],
    "ate_rmse_m": [0.1, 0.3, 0.5, None],
    "before_rmse_m": [0.2, 0.4],
    "moved": 0.25,
}
SUMMARY = {"agents": 4, "scale": "metric", "earlier": FOUND}


def test_who_stands_in_the_earlier_frame_and_how_far_off() -> None:
    first, before, later = earlier_lines(SUMMARY)
    assert first == "earlier map    2 agents, in the frame of agent_00; of the 2 later ones in it: agent_02"
    assert "0.300 m before, 0.200 m now" in before
    assert "0.500 m" in later
    (section,) = earlier_sections(SUMMARY)
    assert "moved by 0.250 m" in section.note
    rows = [row.split("</td>") for row in section.body.split("<tr>")[2:]]
    told = [[cell.rpartition(">")[2] for cell in row[:5]] for row in rows]
    assert told == [
        ["agent_00", "earlier", "0.200 m", "0.100 m", ""],
        ["agent_01", "earlier", "0.400 m", "0.300 m", ""],
        ["agent_02", "later", "–", "0.500 m", "stands in it"],
        ["agent_03", "later", "–", "–", "not joined"],
    ]


def test_other_runs_say_nothing_of_one() -> None:
    assert earlier_lines({"agents": 2}) == [] and earlier_sections({"agents": 2, "earlier": None}) == []
