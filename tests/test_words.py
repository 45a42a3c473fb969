"""The field's words: expressions that the product once had for itself do not come back, in names, comments, docstrings,
help or reports."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("backend", "descriptors", "docs", "frontend", "mas", "tools")
SUFFIXES = (".py", ".css", ".md")
FILES = [p for folder in FOLDERS for p in sorted((ROOT / folder).rglob("*")) if p.suffix in SUFFIXES]

WORDS = {
    r"on the (air|wire)": "transmitted, bytes sent",
    r"<yards?>": "reference unit",
    r"<(desk|diary|diaries)>": "agent context, event log",
    r"<(honest|honesty|citizens?)>": "reputation, reliability, consistency",
    r"<testimon(y|ies)>": "cycle consistency",
    r"<(told|news)>": "sent key-frames, pending matches; a text is a caption, a difference is distinguished",
    r"<(hear|hears|heard)>": "receive",
    r"<place[ _]?(book|log)s?>": "match candidates, peer queries",
    r"<(held[ _]maps?|shops?|stock|edition)>": "map copy, seller, map version",
    r"<(map sales?|sale of maps)>": "map exchange",
    r"<(fate of|their fate|its fate|fates of)": "outcome",
    r"soon after an accepted": "skipped: close to an accepted match",
    r"<odd agents?>": "faulty agents",
    r"<onlookers?>": "ground-truth evaluator",
    r"<(true|closed) ways?>|<way (of|through|driven)>": "path, trajectory",
    r"<(bytes?|points?|numbers?|ms|time|cost|memory|one|frames) an? (key-)?(frame|second)s?>": "per frame",
    r"<beside the maps?>": "excluding the map",
    r"<(one door|door to|ground floor)>": "entry point, shared primitives",
    r"<before (the camera|a surface)>": "in front of",
    r"<boasts?>": "is over-confident",
    r"<for want of>": "without",
    r"nobody had looked at": "held-out",
    r"goes on with it": "rerun the same command to resume",
    r"<explored>": "exploration",
    r"^least$": "minimum",
    r"<other than frame": "unlike",
}
"""Pattern, ``<`` and ``>`` for where a word begins and ends (an underscore ends one too), to the words to use."""
EARLIER = "tools/common/earlier_settings.py"  # names of 0.1
REAL_THINGS = {
    "<(desk|diary|diaries)>": ("tools/worlds/indoor",),  # furniture
    "<(held[ _]maps?|shops?|stock|edition)>": ("tools/worlds/town", EARLIER),  # houses
    "<(honest|honesty|citizens?)>": (EARLIER,),
}


def pattern_of(word: str) -> re.Pattern[str]:
    return re.compile(word.replace("<", r"(?<![a-zA-Z-])").replace(">", r"(?![a-zA-Z])"), re.IGNORECASE)


@cache
def texts_of(path: Path) -> tuple[str, ...]:
    """The file as one line, so that a phrase may be broken over two; of Python also each literal, joined."""
    source = path.read_text(encoding="utf-8")
    found = [re.sub(r"\s+(#\s+)?", " ", source)]
    if path.suffix == ".py":
        constants = (node.value for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Constant))
        found += [" ".join(value.split()) for value in constants if isinstance(value, str)]
    return tuple(dict.fromkeys(found))


def hits(word: str, path: Path) -> list[str]:
    pattern = pattern_of(word)
    found = (pattern.search(text) for text in texts_of(path))
    return sorted({match.string[max(match.start() - 30, 0) : match.end() + 30] for match in found if match})


@pytest.mark.parametrize("word", WORDS)
def test_a_word_of_our_own_does_not_come_back(word: str) -> None:
    allowed = REAL_THINGS.get(word)
    wrong = []
    for path in FILES:
        name = path.relative_to(ROOT).as_posix()
        if allowed is None or not name.startswith(allowed):
            wrong += [f"{name}: …{hit}…" for hit in hits(word, path)]
    assert not wrong, f"use: {WORDS[word]}\n" + "\n".join(wrong)


def test_all_folders_are_looked_at() -> None:
    assert all(any(p.is_relative_to(ROOT / folder) for p in FILES) for folder in FOLDERS)
    assert len(FILES) > 200


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("YARD_IMAGES = 12\n", r"<yards?>"),
        ("cpu_yards = 1\n", r"<yards?>"),
        ('"""Bytes on the\nair."""\n', r"on the (air|wire)"),
        ("# Bytes on the\n# wire.\n", r"on the (air|wire)"),
        ('HELP = "bytes on " "the wire"\n', r"on the (air|wire)"),
        (
            '"""Cost a frame."""\n',
            r"<(bytes?|points?|numbers?|ms|time|cost|memory|one|frames) an? (key-)?(frame|second)s?>",
        ),
    ],
)
def test_a_word_is_found_in_names_and_over_line_ends(text: str, word: str, tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(text, encoding="utf-8")
    assert hits(word, tmp_path / "a.py")


def test_a_longer_word_is_another() -> None:
    assert not pattern_of(r"<yards?>").search("a yardstick in courtyards")
