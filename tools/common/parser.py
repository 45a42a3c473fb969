"""The parser of the command line: short help, and what was probably meant where a name is wrong."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from maslam._suggestions import did_you_mean, nearest

from .earlier_settings import Removed, Renamed, fate
from .errors import UnknownName
from .essential_options import ESSENTIAL

EVERYWHERE = "every command"  # title of the options that all commands share


def at_least_one(text: str) -> int:
    """For argparse: a whole number from 1 on."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"at least 1, not {number}")
    return number


at_least_one.__name__ = "int"  # argparse names the type where the text is no number


class CommandParser(argparse.ArgumentParser):
    """``--help`` shows the options in :data:`ESSENTIAL`, ``--help-all`` all of them; an unknown option, command or
    choice raises ``UnknownName`` with the nearest ones.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **{**kwargs, "add_help": False, "allow_abbrev": False})
        self.everywhere = self.add_argument_group(EVERYWHERE)
        self.everywhere.add_argument("-h", "--help", action="help", help="show this help")
        self.everywhere.add_argument("--help-all", action=_HelpAll, help="show it with all options")

    @property
    def command(self) -> str:
        """The command and, where it has actions, the action: ``bench vo``."""
        return self.prog.partition(" ")[2]

    def with_actions(self) -> Iterator[CommandParser]:
        """This parser and those of its actions."""
        yield self
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                for one in action.choices.values():
                    yield from one.with_actions()

    def format_help(self) -> str:
        """The short help, where there is one."""
        shown = [self._option_string_actions[name] for name in ESSENTIAL.get(self.command, ())]
        if not shown:
            return self.format_all()
        positional = self._get_positional_actions()
        common = [a for a in self.everywhere._group_actions if a not in shown]
        sections = [("arguments", positional), ("options that matter most", shown), (EVERYWHERE, common)]
        more = len(self._actions) - len(positional) - len(shown) - len(common)
        last = f"{more} more options: {self.prog} --help-all" if more else None
        return self._formatted(sections, last)

    def format_all(self) -> str:
        """Every option, by section; those of every command last."""
        groups = [group for group in self._action_groups if group is not self.everywhere]
        return self._formatted([(g.title or "", g._group_actions) for g in (*groups, self.everywhere)], None)

    def format_usage(self) -> str:
        """One line: options are many."""
        return f"usage: {self.usage or self._short_usage()}\n"

    def _short_usage(self) -> str:
        around = {"+": "{}...", "*": "[{}...]", "?": "[{}]", argparse.PARSER: "{} ..."}
        words = [(str(a.nargs), str(a.metavar or a.dest)) for a in self._get_positional_actions()]
        return " ".join([self.prog, "[options]", *(around.get(nargs, "{}").format(name) for nargs, name in words)])

    def _formatted(self, sections: Iterable[tuple[str, list[argparse.Action]]], last: str | None) -> str:
        formatter = self._get_formatter()
        formatter.add_usage(self.usage or self._short_usage(), (), ())
        formatter.add_text(self.description)
        for title, actions in sections:
            formatter.start_section(title)
            formatter.add_arguments(actions)
            formatter.end_section()
        formatter.add_text(self.epilog)
        formatter.add_text(last)
        return formatter.format_help()

    def parse_known_args(  # type: ignore[override]  # overloaded there by the kind of namespace
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> Any:
        """As the base class, after a look at the names: a wrong one is reported before what is missing."""
        for word in self._own_words(list(args or [])):
            name = word.partition("=")[0]
            if name not in self._option_string_actions:
                raise UnknownName(self._about(name))
        return super().parse_known_args(args, namespace)

    def _own_words(self, words: list[str]) -> list[str]:
        """Those that look like options of this parser: up to ``--``, and before the action where there are actions."""
        words = words[: words.index("--")] if "--" in words else words
        if any(isinstance(action, argparse._SubParsersAction) for action in self._actions):
            first = next((k for k, word in enumerate(words) if not word.startswith("-")), len(words))
            words = words[:first]
        return [word for word in words if word[:1] == "-" and word != "-" and " " not in word and not _is_number(word)]

    def _about(self, option: str) -> str:
        """What to do about an unknown option."""
        became = fate(option.lstrip("-").replace("-", "_"))
        if isinstance(became, Renamed):
            return f"{option} was an option of version 0.1; it is --{became.to.replace('_', '-')} today"
        if isinstance(became, Removed):
            return f"{option} was an option of version 0.1 and is gone: {became.why}"
        known = [name for name in self._option_string_actions if name.startswith("--")]
        all_of_them = f"; {self.prog} --help-all shows all" if self.command else ""
        if not self.command and not nearest(option, known):
            return f"unknown option {option} before the command; the options of a command stand after it"
        return f"unknown option {option}{did_you_mean(option, known, all_of_them)}"

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        name = action.option_strings[-1] if action.option_strings else str(action.metavar or action.dest).lower()
        near = did_you_mean(str(value), map(str, action.choices))
        raise UnknownName(
            f"{name} {value}: no such choice{near}" if name[:1] == "-" else f"unknown {name} '{value}'{near}"
        )


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


class _HelpAll(argparse.Action):
    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None) -> None:
        super().__init__(option_strings, dest, nargs=0, default=argparse.SUPPRESS, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        assert isinstance(parser, CommandParser)
        parser._print_message(parser.format_all(), sys.stdout)
        parser.exit()


def add_ray(parser: argparse.ArgumentParser, what: str) -> None:
    """``--ray [ADDRESS]``."""
    parser.add_argument(
        "--ray",
        metavar="ADDRESS",
        nargs="?",
        const="",
        help=f"{what} on a Ray cluster whose machines see the same folders (without ADDRESS: RAY_ADDRESS, else this "
        "machine alone)",
    )
