"""Sweeps: what is run, what is kept, what the tables say."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from maslam.tools import cli
from maslam.tools.common.errors import UsageError
from maslam.tools.sweep.plan import TOWN, Cell, SweepPlan, experiment
from maslam.tools.sweep.rows import Row, Spread, grouped
from maslam.tools.sweep.tables import report
from maslam.tools.sweep.thesis import TABLES


def row(**changes: object) -> Row:
    values: dict[str, object] = dict.fromkeys(Row.__dataclass_fields__, 1.0)
    names = {"sequence": "00", "agents": 20, "preset": "selection", "seed": 0, "largest_group": 20, "accepted": 50}
    return Row(**{**values, **names, **changes})  # type: ignore[arg-type]


def test_cells_are_the_product_and_a_town_has_its_own_numbers_of_agents() -> None:
    plan = SweepPlan(sequences=("00", TOWN), agents=(4, 10), presets=("default", "maslam"), seeds=(0, 1))
    cells = list(plan.cells())
    assert len(cells) == len(set(cells)) == 2 * 2 * 2 + 1 * 2 * 2
    assert {c.agents for c in cells if c.sequence == TOWN} == {10}
    assert Cell("00", 4, "maslam", 1).name == "00_004_maslam_1"


def test_names_of_sequences_keep_their_zeros(tmp_path: Path) -> None:
    for name in ("00", "07", "08"):
        (tmp_path / f"{name}.txt").write_text("")  # found, and of no use
    assert cli.main(["sweep", str(tmp_path / "new"), "--sequences", "00,07,08", "--poses", str(tmp_path)]) == 1
    assert "sequences:\n- '00'\n- '07'\n- 08\n" in (tmp_path / "new" / "plan.yaml").read_text().replace("'08'", "08")


def test_plans_by_name() -> None:
    thesis = experiment("thesis")
    assert set(thesis.sequences) == {"00", "05", "08", TOWN} and thesis.agents == (4, 10, 20) and len(thesis.seeds) == 5
    with pytest.raises(UsageError, match="there are thesis, scaling, quick"):
        experiment("lunch")


def test_a_spread_is_half_the_range() -> None:
    groups = grouped([row(seed=0, wire_total=1.0), row(seed=1, wire_total=2.0), row(seed=2, wire_total=3.0)])
    spread = groups[0]["wire_total"]
    assert spread == Spread(2.0, 1.0) and spread.text() == "2.00 ±1.00"
    assert Spread(2.0, 0.001).text() == "2.00"


def test_ours_stands_beside_what_the_thesis_prints() -> None:
    text = report(grouped([row(payload_dvpr=0.5, ate_agents=0.25)]))
    assert "Table 4.3" in text and "0.50 (34.75)" in text and "0.25 (48.51)" in text and "(15.74)" in text
    assert "-" in report(grouped([row(regret_ate=None)]))


def test_the_systems_of_the_thesis_stand_beside_each_other() -> None:
    ours = {"optimised": (90.0, 20.0, 40), "selection": (80.0, 9.0, 38), "default": (45.0, 30.0, 30)}
    rows = [row(preset=p, exploration=e, payload_dvpr=d, accepted=a) for p, (e, d, a) in ours.items()]
    assert "| 00 | 20 | 2.00 | 0.45 | 0.95 | - |" in report(grouped(rows))
    assert "beside each other" not in report(grouped([row()]))


def test_the_printed_tables_say_what_the_text_of_the_thesis_says() -> None:
    selection, optimised = TABLES["selection"][1], TABLES["optimised"][1]
    assert (selection["00", 20].dvpr, optimised["00", 20].dvpr) == (34.75, 63.81)  # section 4.4
    assert all(len(rows) == 9 for _, rows in TABLES.values())


@pytest.mark.slow
def test_a_sweep_is_taken_up_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "sweep"
    command = [
        "sweep",
        str(out),
        "--sequences",
        "town",
        "--town-agents",
        "2",
        "--frames",
        "20",
        "--width",
        "256",
        "--height",
        "160",
        "--presets",
        "default,maslam",
        "--seeds",
        "0,1",
        "--workers",
        "1",
        "--quiet",
    ]
    assert cli.main([*command, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(r["preset"], r["seed"]) for r in rows] == [("default", 0), ("default", 1), ("maslam", 0), ("maslam", 1)]
    for one in rows:
        summary = json.loads((out / "runs" / f"town_002_{one['preset']}_{one['seed']}" / "summary.json").read_text())
        assert one["wire_total"] == pytest.approx(summary["traffic"]["total"]["wire_bytes"] / 1e6)
        assert one["keyframes"] == summary["keyframes"] > 4
        counts = {key: sum(c[key] for c in summary["coverage"]) for key in ("read", "placed")}
        assert (one["frames_read"], one["frames_placed"]) == (counts["read"], counts["placed"])
        assert one["frames_measured"] <= one["frames_placed"] and one["alignment"] == "SE(3)"
        assert one["graphs_fit"] == all(graph["cost"] <= 10 * max(graph["dof"], 1) for graph in summary["graphs"])
    with open(out / "results.csv", newline="") as file:
        assert [r["preset"] for r in csv.DictReader(file)] == [r["preset"] for r in rows]
    assert len(list((out / "figures").glob("*.png"))) >= 5
    assert list((out / "runs").rglob("trajectory.tum")) and not list((out / "runs").rglob("*.ply"))
    before = {p: p.stat().st_mtime_ns for p in (out / "runs").rglob("summary.json")}
    (out / "runs" / "town_002_maslam_1" / "cell.json").write_text("{}")
    assert cli.main(command) == 0
    assert "Preset maslam" in capsys.readouterr().out
    after = {p: p.stat().st_mtime_ns for p in (out / "runs").rglob("summary.json")}
    assert {p.parent.name for p in before if after[p] != before[p]} == {"town_002_maslam_1"}


def test_what_cannot_be_run_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("precious")
    assert cli.main(["sweep", str(tmp_path / "mine")]) == 1
    assert "is no sweep" in capsys.readouterr().err
    assert cli.main(["sweep", str(tmp_path / "new"), "--presets", "best"]) == 2
    assert "there is no preset 'best'" in capsys.readouterr().err
    assert cli.main(["sweep", str(tmp_path / "new"), "--sequences", "99", "--poses", str(tmp_path), "--quiet"]) == 1
    assert "99.txt: no such pose file" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_without_poses_and_images_the_options_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("MASLAM_DATA", raising=False)
    assert cli.main(["sweep", str(tmp_path / "sw"), "--experiment", "quick"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line == (
        "maslam: sequence 07: --poses names the folder of KITTI pose files to render along, "
        "--kitti that of your own KITTI images"
    )
    assert not (tmp_path / "sw").exists()
    assert cli.main(["sweep", "--help"]) == 0
    shown = capsys.readouterr().out
    assert "--poses DIR" in shown and "--kitti DIR" in shown
    assert "--sequences NAME,..." in shown and "--agents INT,..." in shown and "TUPLE" not in shown
