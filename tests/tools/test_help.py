"""Short help, the whole help, and what is said about names that are wrong: a line, exit code 2."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import pytest

from maslam.mas.config import MasConfig
from maslam.tools import cli
from maslam.tools.common import earlier_settings
from maslam.tools.common.earlier_settings import Renamed
from maslam.tools.common.essential_options import ESSENTIAL
from maslam.tools.common.options import leaves, option_name
from maslam.tools.common.parser import CommandParser

MOST_SHOWN = 12
FILES = {"FILE", "DIR", "FILE.onnx", "DATASET", "[SEQUENCE=]FILE"}  # nothing is the default: no file


def parsers() -> Iterator[CommandParser]:
    """The parser of every command, and of every action of one."""
    for command in cli.COMMANDS:
        root = cli.build_parser(command)
        (nested,) = (action for action in root._actions if isinstance(action, argparse._SubParsersAction))
        for parser in nested.choices[command].with_actions():
            if not any(isinstance(action, argparse._SubParsersAction) for action in parser._actions):
                yield parser


ALL = {parser.command: parser for parser in parsers()}


def shown(text: str, parser: CommandParser) -> list[argparse.Action]:
    """The options of ``parser`` that a help text describes, those of every command left out."""
    lines = {line.strip().split("  ")[0].split(" ")[0].rstrip(",") for line in text.splitlines() if line[:3] == "  -"}
    common = {id(action) for action in parser.everywhere._group_actions}
    return [a for a in parser._actions if lines & set(a.option_strings) and id(a) not in common]


def test_every_list_is_of_a_command() -> None:
    assert sorted(set(ESSENTIAL) - set(ALL)) == []


@pytest.mark.parametrize("command", ALL)
def test_help_shows_about_ten_options_and_help_all_shows_every_one(command: str) -> None:
    parser = ALL[command]
    options = shown(parser.format_all(), parser)
    short = shown(parser.format_help(), parser)
    assert len(short) <= MOST_SHOWN
    every = {id(a) for a in parser._actions if a.option_strings} - {id(a) for a in parser.everywhere._group_actions}
    assert {id(action) for action in options} == every
    rest = len(options) - len(short)
    assert (f"{rest} more options: maslam {command} --help-all" in parser.format_help()) == (rest > 0)


@pytest.mark.parametrize("command", ESSENTIAL)
def test_what_is_shown_tells_its_default(command: str) -> None:
    parser = ALL[command]
    for name in ESSENTIAL[command]:
        action = parser._option_string_actions[name]
        takes_value = action.nargs != 0 and action.metavar not in FILES
        assert action.help, name
        assert not takes_value or "default" in action.help, f"maslam {command} {name}: {action.help}"


def test_help_on_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["slam", "--help"]) == 0
    short = capsys.readouterr().out
    assert cli.main(["slam", "--help-all"]) == 0
    whole = capsys.readouterr().out
    assert "--agents N" in short and "--relpose.min-inliers" not in short
    assert "--relpose.min-inliers" in whole and len(whole) > 5 * len(short)
    assert cli.main(["bench", "vo", "--help"]) == 0
    assert "maslam bench vo --help-all" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("slma", "maslam: unknown command 'slma'; did you mean 'slam'?"),
        ("bench voo", "maslam: unknown action 'voo'; did you mean 'vo'?"),
        ("slam --agnets 3", "maslam: unknown option --agnets; did you mean '--agents'?"),
        ("slam a b --agnets=3", "maslam: unknown option --agnets; did you mean '--agents'?"),
        (
            "run a b --relpos.min_inliers=3",
            "maslam: unknown option --relpos.min-inliers; did you mean '--relpose.min-inliers'?",
        ),
        (
            "run a b --descent-sweeps 3",
            "maslam: unknown option --descent-sweeps; did you mean '--optimisation.solver.descent-sweeps'?",
        ),
        ("run a b --xyzzy", "maslam: unknown option --xyzzy; maslam run --help-all shows all"),
        ("bench vo x --comapre y", "maslam: unknown option --comapre; did you mean '--compare'?"),
        ("slam a b --rig stero", "maslam: --rig stero: no such choice; did you mean 'stereo'?"),
        ("slam a b --rig foo", "maslam: --rig foo: no such choice; there are mono, stereo, rgbd"),
        ("--quiet slam", "maslam: unknown option --quiet before the command; the options of a command stand after it"),
        ("slam a b -agents 3", "maslam: unknown option -agents; did you mean '--agents'?"),
        ("run a b --preset defualt", "maslam: --preset defualt: there is no preset 'defualt'; did you mean 'default'?"),
        (
            "run a b --places.code int9",
            "maslam: --places.code int9: places.code: there is no place code 'int9', only auto, float32, float32x128, "
            "int8, int8x128, int4, pq32, pq16; did you mean 'int4' or 'int8'?",
        ),
        (
            "run a b --transport in-proces",
            "maslam: --transport: there is no transport 'in-proces'; did you mean 'in_process'?",
        ),
        ("slam a b --model defualt", "maslam: --model: there is no descriptor 'defualt'; did you mean 'default'?"),
        (
            "preprocess a b --odometry.seed 3",
            "maslam: --odometry.seed was an option of version 0.1 and is gone: it had no effect",
        ),
    ],
)
def test_a_wrong_name_is_a_usage_error_in_one_line(words: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(words.split()) == 2
    assert capsys.readouterr().err == f"{line}\n"


@pytest.mark.parametrize(
    ("command", "text", "line"),
    [
        (
            "run a b --config",
            "seed: 3\npreset: mslam\n",
            ":2: preset: there is no preset 'mslam'; did you mean 'maslam'?",
        ),
        (
            "slam a b --config",
            "policy: diretory\n",
            ":1: there is no policy 'diretory'; did you mean 'directory'?",
        ),
        (
            "slam a b --config",
            "places:\n  latest_frames: 3\n  code: pq23\n",
            ":3: places.code: there is no place code 'pq23', only auto, float32, float32x128, int8, int8x128, int4, "
            "pq32, pq16; did you mean 'pq32'?",
        ),
        (
            "run a b --config",
            "optimisation: {solver: {method: elcted}}\n",
            ":1: optimisation.solver.method: input should be 'dgs', 'jor', 'sor', 'rbcd', 'rbcd-async', "
            "'multifrontal', 'two-level' or 'elected', not 'elcted'; did you mean 'elected'?",
        ),
        ("slam a b --config", "odometri: {}\n", ":1: unknown setting 'odometri'; did you mean 'odometry'?"),
        (
            "slam a b --config",
            "odometry:\n  mapping:\n    windw: 3\n",
            ":3: unknown setting 'odometry.mapping.windw'; did you mean 'odometry.mapping.window'?",
        ),
        ("sweep o --plan", "presets: [mslam]\n", ":1: presets: there is no preset 'mslam'; did you mean 'maslam'?"),
        (
            "sweep o --plan",
            "agents: [2]\nsettings:\n  relpose:\n    min_inlier: 3\n",
            ":4: unknown setting 'settings.relpose.min_inlier'; did you mean 'settings.relpose.min_inliers'?",
        ),
    ],
)
def test_a_wrong_name_in_a_settings_file_is_a_usage_error_with_its_line(
    command: str,
    text: str,
    line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.yaml").write_text(text)
    assert cli.main([*command.split(), "c.yaml"]) == 2
    assert capsys.readouterr().err == f"maslam: c.yaml{line}\n"
    assert [path.name for path in tmp_path.iterdir()] == ["c.yaml"], "nothing was begun"


WORDS = [path for path, field in leaves(MasConfig) if field.annotation is str]


@pytest.mark.parametrize("setting", WORDS)
def test_every_setting_that_takes_a_word_refuses_others(setting: str, capsys: pytest.CaptureFixture[str]) -> None:
    option = option_name(setting)
    assert cli.main(["run", "a", "b", option, "xyzzy"]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"maslam: {option}") and "there is no " in said and "'xyzzy'" in said


@pytest.mark.parametrize("command", ["preprocess a b", "slam a b", "netvlad describe a -o b.npz", "netvlad info"])
def test_a_provider_that_is_not_here_is_a_usage_error(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*command.split(), "--provider", "cup"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("maslam: --provider: onnxruntime has no provider 'cup' here, only: CPU")
    assert said.endswith("; did you mean 'cpu'?\n")


def test_an_option_of_0_1_is_refused_with_todays_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(earlier_settings.SETTINGS_OF_0_1, "relpose.gate", Renamed("relpose.min_inliers"))
    assert cli.main(["run", "a", "b", "--relpose.gate", "3"]) == 2
    said = capsys.readouterr().err
    assert said == "maslam: --relpose.gate was an option of version 0.1; it is --relpose.min-inliers today\n"


def test_values_that_begin_with_a_dash_are_no_options() -> None:
    parser = ALL["netvlad export"]
    assert parser.parse_args(["in", "out", "--note", "-- trained at night --"]).note == "-- trained at night --"
    assert ALL["run"].parse_args(["a", "b", "--places.threshold", "-0.5"])
    assert parser.parse_args(["--", "--in", "--out"]).out.name == "--out"


def test_every_action_takes_the_options_of_every_command() -> None:
    for parser in ALL.values():
        assert {"--help", "--help-all", "--debug"} <= {
            name for action in parser.everywhere._group_actions for name in action.option_strings
        }
