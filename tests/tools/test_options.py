"""Options and files of settings from models: names, precedence, and errors that name what is wrong."""

from __future__ import annotations

import argparse
from enum import StrEnum
from pathlib import Path
from typing import Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field

from maslam.tools.common.errors import ToolError, UnknownName, UsageError
from maslam.tools.common.options import add_model_options, build, leaves, read_settings, read_yaml


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


class Inner(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")
    min_inliers: int = Field(20, ge=1, description="fewer is no match, 100% sure")
    ratio: float | None = 0.75
    sizes: tuple[int, ...] = (1, 2)


class Outer(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")
    colour: Colour = Colour.RED
    mode: Literal["fast", "slow"] = "fast"
    on: bool = True
    relpose: Inner = Inner()


def parse(*words: str, prefix: str = "") -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_model_options(parser, Outer(), prefix)
    parser.format_help()
    return parser.parse_args(words)


def test_every_leaf_is_an_option() -> None:
    assert [name for name, _ in leaves(Outer)] == [
        "colour",
        "mode",
        "on",
        "relpose.min_inliers",
        "relpose.ratio",
        "relpose.sizes",
    ]


def test_types_are_converted() -> None:
    words = [
        "--colour=blue",
        "--on",
        "false",
        "--relpose.min-inliers",
        "7",
        "--relpose.ratio",
        "none",
        "--relpose.sizes",
        "3,4,5",
    ]
    assert build(Outer(), parse(*words)) == Outer(
        colour=Colour.BLUE, on=False, relpose=Inner(min_inliers=7, ratio=None, sizes=(3, 4, 5))
    )


def test_a_choice_may_be_a_number() -> None:
    class Sized(BaseModel):
        model_config = ConfigDict(frozen=True, extra="forbid")
        bytes_each: Literal[8, 16, 32] = 32

    parser = argparse.ArgumentParser()
    add_model_options(parser, Sized())
    assert build(Sized(), parser.parse_args(["--bytes-each", "16"])).bytes_each == 16
    with pytest.raises(UsageError, match="8, 16 or 32"):
        build(Sized(), parser.parse_args(["--bytes-each", "12"]))


def test_options_win_over_the_file_and_the_file_over_the_base() -> None:
    base = Outer(mode="slow", relpose=Inner(min_inliers=5, ratio=0.5))
    file = {"relpose": {"min_inliers": 6, "sizes": [9]}}
    built = build(base, parse("--relpose.min-inliers", "7"), file)
    assert built == Outer(mode="slow", relpose=Inner(min_inliers=7, ratio=0.5, sizes=(9,)))


def test_a_prefix_keeps_two_models_apart() -> None:
    assert build(Outer(), parse("--odometry.mode", "slow", prefix="odometry"), prefix="odometry").mode == "slow"


@pytest.mark.parametrize(
    ("file", "message"),
    [
        (
            {"relpose": {"min_inlier": 3}},
            r"c\.yaml: unknown setting 'relpose\.min_inlier'; did you mean 'relpose\.min_inliers'\?",
        ),
        ({"relpose": {"min_inliers": 0}}, r"c\.yaml: relpose\.min_inliers: .*greater than or equal to 1, not 0"),
        ({"colour": "green"}, r"c\.yaml: colour: .*'red' or 'blue'.*'green'"),
        ({"relpose": 3}, r"c\.yaml: relpose"),
    ],
)
def test_a_wrong_file_is_an_error_that_names_the_key(file: dict[str, object], message: str) -> None:
    with pytest.raises(ToolError, match=message):
        build(Outer(), parse(), file, Path("c.yaml"))


def test_a_wrong_option_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match=r"--relpose\.min-inliers many: relpose\.min_inliers: .*integer"):
        build(Outer(), parse("--relpose.min-inliers", "many"))
    with pytest.raises(SystemExit):
        parse("--relpose.min-inlierz", "3")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("on: true\nrelpose:\n  min_inlier: 3\n", "c.yaml:3: unknown setting 'relpose.min_inlier'; did you mean"),
        ("relpos: {ratio: 0.5}\n", "c.yaml:1: unknown setting 'relpos'; did you mean"),
        (
            "on: true\nmode: fats\n",
            "c.yaml:2: mode: input should be 'fast' or 'slow', not 'fats'; did you mean 'fast'?",
        ),
        ("colour: rde\n", "c.yaml:1: colour: input should be 'red' or 'blue', not 'rde'; did you mean 'red'?"),
    ],
)
def test_unknown_names_in_a_file_are_usage_errors_with_their_line(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(UnknownName) as error:
        build(Outer(), parse(), read_settings(path), path)
    assert str(error.value).startswith(f"{tmp_path}/{said}")


def test_a_value_out_of_range_is_told_with_its_line_and_section(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text("other: 1\npart:\n  relpose:\n    sizes: [1, two]\n")
    with pytest.raises(ToolError, match=r"c\.yaml:4: part\.relpose\.sizes\.1: .*'two'"):
        build(Outer(), parse(), read_settings(path)["part"], path, "part")


def test_the_sections_of_a_file_may_be_limited(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text("odometry: {}\nodometri: {}\n")
    with pytest.raises(UnknownName, match=r"c\.yaml:2: unknown setting 'odometri'; did you mean 'odometry'\?"):
        read_settings(path, ["odometry"])
    assert read_settings(None, ["odometry"]) == {}


def test_a_wrong_choice_names_the_nearest() -> None:
    with pytest.raises(UnknownName, match=r"--mode slwo: mode: .*; did you mean 'slow'\?"):
        build(Outer(), parse("--mode", "slwo"))


def test_broken_yaml_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text("a: [1, 2")
    with pytest.raises(ToolError, match=r"c\.yaml: not YAML"):
        read_yaml(path)
    path.write_text("- 1")
    with pytest.raises(ToolError, match="expected keys and values"):
        read_yaml(path)
    path.write_text("")
    assert read_yaml(path) == {}
