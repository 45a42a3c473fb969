"""Coverage in words: percentages, reasons by kind, names of agents."""

from __future__ import annotations

from typing import Any

import pytest

from maslam.tools.report.coverage_table import agent_names, coverage_rows, lost_lines, percent_text
from maslam.tools.report.measured import measured_on, odometry_measured_on
from maslam.tools.report.summary_table import why_text


def summary(**coverage: Any) -> dict[str, Any]:
    one = {"sequence": "drive", "read": 551, "tracked": 88, "placed": 88, "tracks": 1, "tracks_placed": 1, "lost": []}
    alignment = {"kind": "Sim(3)", "scale": 3.2104, "frames": 88}
    return {"agents": 1, "coverage": [{**one, **coverage}], "alignments": {"agents": [alignment]}}


@pytest.mark.parametrize(
    ("percent", "text"), [(100.0, "100.0 %"), (99.99, "99.9 %"), (99.8, "99.8 %"), (15.97, "16.0 %"), (0.0, "0.0 %")]
)
def test_what_is_not_all_is_never_a_hundred_percent(percent: float, text: str) -> None:
    assert percent_text(percent) == text


def test_a_row_says_frames_and_alignment() -> None:
    (row,) = coverage_rows(summary())
    assert row == ["agent_00", "551", "88 (16.0 %)", "88 (16.0 %)", "1 of 1", "88 frames", "Sim(3), scale 3.21"]
    assert measured_on(summary()) == "measured on 88 of 551 frames read, after Sim(3) alignment, scale 3.21"


def test_odometry_says_its_frames_and_alignment() -> None:
    def odometry(*found: tuple[int, int] | None) -> str:
        one = [None if f is None else {"kind": "Sim(3)", "scale": 2.5, "frames": f[0], "tracks": f[1]} for f in found]
        own = [None if f is None else {"kind": "SE(3)", "scale": 1.0, "frames": 88} for f in found]
        return odometry_measured_on({"alignments": {"agents": own, "odometry": one}})

    assert odometry((88, 1)) == "on the same frames, after Sim(3) alignment, scale 2.5"
    assert odometry((88, 2)) == "on the same frames, after Sim(3) alignment of each track by itself, scale 2.5"
    assert odometry((88, 1), (86, 3), None) == (
        "on 174 of these 176 frames, after Sim(3) alignment of each track by itself, scale 2.5 to 2.5"
    )
    assert odometry(None) == ""
    before = {"kind": "SE(3)", "scale": 1.0, "frames": 60}
    said = odometry_measured_on({"alignments": {"agents": [before], "odometry": [before]}})
    assert said == "on the longest track of each agent (60 frames), after SE(3) alignment"


def test_reasons_that_differ_by_figures_are_one_kind_and_many_are_cut() -> None:
    def lost(first: int, last: int, reason: str) -> dict[str, Any]:
        return {"first_frame": first, "last_frame": last, "reason": reason}

    few = [lost(10 * k, 10 * k + 4, f"few points: {k} of 80") for k in range(5)]
    others = [lost(100 + k, 100 + k, f"reason {word}") for k, word in enumerate("abcdef")]
    lines = lost_lines(summary(lost=[*few, lost(60, 61, "too dark"), *others]))
    spans = "0 to 4, 10 to 14, 20 to 24 and 2 more"
    assert lines[0] == f"agent_00: 25 frames lost ({spans}): few points: 0 of 80 (the first of 5)"
    assert lines[1] == "agent_00: 2 frames lost (60 to 61): too dark"
    assert lines[-1] == "agent_00: 4 frames lost for 4 other reasons" and len(lines) == 5


def test_frames_of_several_intervals_are_counted_by_kind() -> None:
    def lost(first: int, last: int, **kinds: int) -> dict[str, Any]:
        return {"first_frame": first, "last_frame": last, "reason": f"of {first}", "kinds": kinds}

    alike = [lost(0, 4, dark=3, few=2), lost(10, 19, few=9, dark=1)]
    lines = lost_lines(summary(lost=[*alike, lost(30, 33, dark=4), lost(40, 40, dark=1)]))
    assert lines == [
        "agent_00: 15 frames lost (0 to 4, 10 to 19): few (11 frames); dark (4 frames)",
        "agent_00: 5 frames lost (30 to 33, 40 to 40): dark",
    ]
    assert lost_lines(summary(lost=[lost(0, 4, dark=3, few=2)])) == ["agent_00: 5 frames lost (0 to 4): of 0"]


def test_lost_frames_have_the_names_of_their_images_where_these_are_others() -> None:
    def lost(first: int, last: int, **images: str) -> dict[str, Any]:
        return {"first_frame": first, "last_frame": last, "reason": "dark", **images}

    entries = [
        lost(5, 6, first_image="000017", last_image="000018"),
        lost(9, 9, first_image="000023", last_image="000023"),
    ]
    (line,) = lost_lines(summary(lost=entries))
    assert line == "agent_00: 3 frames lost (5 to 6 = 000017 to 000018, 9 to 9 = 000023): dark"


def test_agents_are_named_for_their_images_where_these_tell_them_apart() -> None:
    coverage = summary()["coverage"][0]
    several = {"agents": 2, "coverage": [{**coverage, "sequence": name} for name in ("kitchen", "agent_01")]}
    assert agent_names(several) == ["agent_00 (kitchen)", "agent_01"]
    one = {"agents": 2, "coverage": [coverage, coverage]}
    assert agent_names(one) == ["agent_00", "agent_01"]


def test_a_run_from_before_has_no_coverage() -> None:
    old: dict[str, Any] = {"agents": 2}
    assert coverage_rows(old) == [] and lost_lines(old) == [] and measured_on(old) == ""


@pytest.mark.parametrize(("outcome", "reason", "detail", "text"), [
    ("rejected", "too few matches", "too few matches: 5 < 8", "too few matches: 5 < 8"),
    ("rejected", "beyond the unit's drift", "beyond the unit's drift", "beyond the unit's drift"),
    ("rejected", "no agreeing match", "accepted", "no agreeing match"),
    ("skipped", "not verified", "the contract ended", "not verified: the contract ended"),
    ("skipped", "close to an accepted match", "", "close to an accepted match"),
    ("accepted", "accepted", "accepted", ""),
])  # fmt: skip
def test_a_match_has_its_reason_once(outcome: str, reason: str, detail: str, text: str) -> None:
    assert why_text({"outcome": outcome, "reason": reason, "detail": detail}) == text
