"""The reference pages, made from the parsers, the settings' types and the docstrings: nothing in them is written twice.

``pages()`` gives each page's name and Markdown; the site's hook asks for them whenever the site is built, and
``python docs/scripts/reference.py OUT`` writes them as files.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import file_formats
import python_reference

from maslam.tools.cli import COMMANDS, build_parser
from maslam.tools.common.options import DEST

_DEFAULT = re.compile(r"\s*\(default: (.*)\)$", re.DOTALL)
_SAME_SETTINGS = {"maslam slam": "maslam run"}
"""Commands that take the top-level settings of another one."""


@dataclass
class Settings:
    """The settings of one section: rows of option, values, default, meaning; and the commands that take them."""

    commands: list[str] = field(default_factory=list)
    rows: dict[str, tuple[str, str, str, str]] = field(default_factory=dict)


def pages() -> dict[str, str]:
    """Markdown by the page's path inside ``docs/``."""
    return {
        "reference/commands.md": commands_page(),
        "reference/settings.md": settings_page(),
        "reference/python.md": python_reference.page(),
        "reference/files.md": file_formats.page(),
    }


# -- command line -----------------------------------------------------------------------------------------------------


def parsers() -> Iterator[argparse.ArgumentParser]:
    """Every command and action, in the order of ``maslam --help``."""
    for name in COMMANDS:
        yield from parsers_of(name)


def parsers_of(command: str) -> Iterator[argparse.ArgumentParser]:
    """A command, then its actions."""
    yield from _with_actions(_choices(build_parser(command))[command])


def _choices(parser: argparse.ArgumentParser) -> dict[str, Any]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def _with_actions(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    yield parser
    for inner in _choices(parser).values():
        yield from _with_actions(inner)


def is_setting(action: argparse.Action) -> bool:
    """Whether an option comes from a configuration type."""
    return action.dest.startswith(DEST)


def section_of(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    """``places`` of ``--places.threshold``; of a top-level setting the command's own name."""
    section = action.dest.removeprefix(DEST).rpartition(".")[0]
    return section or _SAME_SETTINGS.get(parser.prog, parser.prog)


def commands_page() -> str:
    """One section a command, with its arguments and its own options."""
    lines = ["# Commands", "", "Every command, its arguments and its own options. Generated from the parsers.", ""]
    lines += ["Settings, which also stand in `config.yaml`, have a page of their own: [Settings](settings.md).", ""]
    everywhere = common_options()
    lines += ["## Every command", "", *_arguments(next(parsers()), lambda action: option_of(action) in everywhere)]
    for parser in parsers():
        lines += [f"## {parser.prog}", "", _cell(parser.description or ""), ""]
        lines += _arguments(parser, lambda action: option_of(action) not in everywhere)
        sections = dict.fromkeys(section_of(parser, a) for a in parser._actions if is_setting(a))
        links = [f"[{name}](settings.md#{_anchor(name)})" for name in sections]
        lines += [f"Settings: {', '.join(links)}.", ""] if links else []
    return "\n".join(lines)


def option_of(action: argparse.Action) -> str:
    """The first name of an option; of an argument nothing."""
    return action.option_strings[0] if action.option_strings else ""


def common_options() -> set[str]:
    """Options that every command and action has."""
    return set.intersection(*({option_of(action) for action in parser._actions} - {""} for parser in parsers()))


def _arguments(parser: argparse.ArgumentParser, wanted: Callable[[argparse.Action], bool]) -> list[str]:
    own = [action for action in parser._actions if not is_setting(action) and _has_row(action) and wanted(action)]
    rows = [f"| {_names(action)} | {_cell(_help(parser, action))} |" for action in own]
    return ["| argument | meaning |", "|---|---|", *rows, ""] if rows else []


def _has_row(action: argparse.Action) -> bool:
    return not isinstance(action, argparse._SubParsersAction | argparse._HelpAction)


def _names(action: argparse.Action) -> str:
    value = action.metavar if isinstance(action.metavar, str) else action.dest.upper()
    if action.choices is not None:
        value = f"{{{','.join(str(choice) for choice in action.choices)}}}"
    if not action.option_strings:
        return _code(value if action.metavar else action.dest)
    flag = action.nargs == 0
    return _code(f"{', '.join(action.option_strings)}{'' if flag else ' ' + value}")


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    """As ``--help`` would say it, also where the short help leaves it out."""
    said = "" if action.help in (None, argparse.SUPPRESS) else str(action.help)
    return said % {**vars(action), "prog": parser.prog} if "%" in said else said


# -- settings ---------------------------------------------------------------------------------------------------------


def all_settings() -> dict[str, Settings]:
    """Every setting of every command, by section."""
    found: dict[str, Settings] = {}
    for parser in parsers():
        for action in filter(is_setting, parser._actions):
            section = found.setdefault(section_of(parser, action), Settings())
            if parser.prog not in section.commands:
                section.commands.append(parser.prog)
            section.rows.setdefault(action.dest.removeprefix(DEST), _row(parser, action))
    return found


def _row(parser: argparse.ArgumentParser, action: argparse.Action) -> tuple[str, str, str, str]:
    said = _help(parser, action)
    default = _DEFAULT.search(said)
    meaning = _DEFAULT.sub("", said)
    return action.option_strings[0], str(action.metavar), default.group(1) if default else "", meaning


def settings_page() -> str:
    """A table for each section."""
    lines = [
        "# Settings",
        "",
        "Every setting is an option of the command line and a key in a YAML file (`--config FILE`): the option "
        "`--places.max-points` is the key `max_points` in the section `places`. A run writes all of them to "
        "`config.yaml`. Later wins: the preset, the file, the command line. An unknown key is an error.",
        "",
        "Generated from the configuration types; defaults of agents are those of preset `maslam`.",
        "",
    ]
    for name, section in all_settings().items():
        lines += [f"## {name}", "", f"Of {', '.join(f'`{command}`' for command in section.commands)}.", ""]
        lines += ["| option | values | default | meaning |", "|---|---|---|---|"]
        for option, values, default, meaning in section.rows.values():
            kinds = ", ".join(_code(value) for value in values.split("|"))
            lines.append(f"| `{option}` | {kinds} | {_code(default)} | {_cell(meaning)} |")
        lines.append("")
    return "\n".join(lines)


def _code(text: str) -> str:
    """Code in a table's cell, without the bar that would end the cell."""
    return f"`{text.replace('|', ' or ')}`"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def _anchor(title: str) -> str:
    """As the site makes it from a heading."""
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", title).strip().lower())


def main() -> None:
    """Write the pages under the folder given."""
    out = Path(sys.argv[1])
    for name, text in pages().items():
        path = out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
