"""Settings files and options of version 0.1: read, or refused in a line that names today's word."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import pytest
import yaml

from maslam._replaced import replaced
from maslam.frontend.config import OdometryConfig
from maslam.mas.config import MasConfig
from maslam.tools import cli
from maslam.tools.common.earlier_settings import SETTINGS_OF_0_1, Fate, Removed, Renamed, fate, modernised
from maslam.tools.common.errors import ToolError
from maslam.tools.common.options import build, read_settings
from maslam.tools.pipeline.preprocess_options import settings_from

OF_0_1 = Path(__file__).parent / "of_0_1"
TABLE: dict[str, Fate] = {
    "odometry.seed": Removed("it had no effect"),
    "standing": Renamed("reputation"),
    "standing.honesty": Renamed("reputation.consistency"),
    "merge.form": Renamed("merge.form", {"compact": "delta"}),
}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("odometry.seed", Removed("it had no effect")),
        ("standing.honesty", Renamed("reputation.consistency")),
        ("standing.probe_s", Renamed("reputation.probe_s")),
        ("standing", Renamed("reputation")),
        ("odometry.features.tracks", None),
        ("standings.probe_s", None),
    ],
)
def test_a_setting_of_its_own_wins_over_its_section(name: str, expected: Fate | None) -> None:
    assert fate(name, TABLE) == expected


def test_a_file_is_read_under_todays_names_and_said_in_a_line(caplog: pytest.LogCaptureFixture) -> None:
    content = {
        "seed": 3,
        "odometry": {"seed": 5, "features": {"tracks": 300}},
        "standing": {"honesty": 0.5, "probe_s": 9.0},
        "merge": {"form": "compact"},
        "faults": {"late_s": {2: 10.0}},
    }
    assert modernised(content, Path("c.yaml"), TABLE) == {
        "seed": 3,
        "odometry": {"features": {"tracks": 300}},
        "reputation": {"consistency": 0.5, "probe_s": 9.0},
        "merge": {"form": "delta"},
        "faults": {"late_s": {2: 10.0}},
    }
    (line,) = [record.getMessage() for record in caplog.records]
    assert line == (
        "c.yaml: settings of version 0.1: standing.honesty is now reputation.consistency, standing.probe_s is now "
        "reputation.probe_s; odometry.seed is gone (it had no effect)"
    )


def test_a_file_of_today_is_left_as_it_is(caplog: pytest.LogCaptureFixture) -> None:
    content = {"seed": 3, "relpose": 4}
    assert modernised(content, Path("c.yaml"), TABLE) is content
    assert caplog.records == []


def test_both_names_at_once_are_an_error() -> None:
    content = {"standing": {"probe_s": 1.0}, "reputation": {"probe_s": 2.0}}
    with pytest.raises(
        ToolError, match=r"c\.yaml: 'standing\.probe_s' is called 'reputation\.probe_s' today, and both"
    ):
        modernised(content, Path("c.yaml"), TABLE)


def test_the_config_of_a_run_of_0_1_is_read() -> None:
    """All its values arrive: each is that of the preset then, which the result is, without what came later."""
    from maslam.mas.policies.presets import preset

    content, today = read_settings(OF_0_1 / "config.yaml"), preset("maslam")
    then = replaced(
        today,
        places=replaced(today.places, widen_keyframes=None, gap_least_keyframes=None, closing_ends=False),
        optimisation=replaced(
            today.optimisation,
            match_sigma_depth=0.005,
            solver=replaced(today.optimisation.solver, elected_fineness=512.0, length_sigma=0.0, update_tolerance=5e-5),
        ),
    )
    assert build(MasConfig(), argparse.Namespace(), content, OF_0_1 / "config.yaml") == then
    assert content["preset"] == "maslam"


def test_the_odometry_settings_of_0_1_are_read(caplog: pytest.LogCaptureFixture) -> None:
    path = OF_0_1 / "odometry.yaml"
    arguments = parser_of("preprocess").parse_args(["SRC", "OUT", "--config", str(path)])
    assert settings_from(arguments, read_settings(path)).odometry == OdometryConfig()
    (line,) = [record.getMessage() for record in caplog.records]
    assert "odometry.seed is gone (it had no effect)" in line


def names_of_0_1() -> dict[str, list[str]]:
    """Command (and action) to its options in version 0.1."""
    found: dict[str, list[str]] = {}
    for line in (OF_0_1 / "options.txt").read_text(encoding="utf-8").splitlines():
        command, _, option = line.rpartition(" ")
        found.setdefault(command, []).append(option)
    return found


def parser_of(command: str) -> argparse.ArgumentParser:
    words = command.split()
    parser = cli.build_parser(words[0])
    for word in words:
        (nested,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
        parser = nested.choices[word]
    return parser


@pytest.mark.parametrize("command", names_of_0_1())
def test_every_option_of_0_1_is_known_or_in_the_table(command: str) -> None:
    """Whoever renames a setting enters it in the table, or those who used it are left without a word."""
    known = parser_of(command)._option_string_actions
    for option in names_of_0_1()[command]:
        if option in known:
            continue
        became = fate(option.removeprefix("--").replace("-", "_"))
        assert became is not None, f"maslam {command} {option} was an option of 0.1: enter it in {fate.__module__}"
        if isinstance(became, Renamed):
            assert "--" + became.to.replace("_", "-") in known


def test_every_file_of_0_1_has_all_its_settings() -> None:
    """The samples are whole: as many settings as the options of the same commands."""
    for name, section, command in (("config.yaml", "", "run"), ("odometry.yaml", "odometry.", "preprocess")):
        content = yaml.safe_load((OF_0_1 / name).read_text(encoding="utf-8"))
        written = {option.removeprefix("--").replace("-", "_") for option in names_of_0_1()[command]}
        expected = {one for one in written if one.startswith(section) and one not in {"config", "quiet", "debug"}}
        assert set(flat(content)) == expected


def flat(content: dict[str, Any], section: str = "") -> list[str]:
    names = []
    for key, value in content.items():
        deeper = isinstance(value, dict) and value
        names += flat(value, f"{section}{key}.") if deeper else [f"{section}{key}"]
    return names


def test_every_entry_of_the_table_was_a_setting_of_0_1() -> None:
    written = {option.removeprefix("--").replace("-", "_") for options in names_of_0_1().values() for option in options}
    for name in SETTINGS_OF_0_1:
        assert any(one == name or one.startswith(f"{name}.") for one in written), name
