"""The documents' links, anchors and pictures lead somewhere; their commands and their Python exist."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
import reference

import maslam
from maslam.tools.cli import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
TEXTS = (*(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").glob("*.md"))
PAGES = [*(ROOT / f"{name}.md" for name in ("README", "CHANGELOG", "CONTRIBUTING")), *sorted(TEXTS)]
ALL_PAGES = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^#+ +(.+?)\s*$", re.MULTILINE)
DISTANT = ("http://", "https://", "mailto:")


def prose(text: str) -> str:
    """A page without its code blocks."""
    return FENCE.sub("", text)


def anchors(text: str) -> set[str]:
    """Anchors of a page's headings, as code-hosting pages and the site make them."""
    titles = (re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", title) for title in HEADING.findall(prose(text)))
    return {re.sub(r"\s", "-", re.sub(r"[^\w\s-]", "", title).strip().lower()) for title in titles}


def broken_links(page: Path, text: str) -> list[str]:
    """Links of a page that lead nowhere."""
    broken = []
    for link in LINK.findall(prose(text)):
        if link.startswith(DISTANT):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        found = target == page or target.exists()
        known = text if target == page else target.read_text(encoding="utf-8") if found and anchor else ""
        if not found or (anchor and anchor not in anchors(known)):
            broken.append(link)
    return broken


def blocks(text: str, *languages: str) -> Iterator[str]:
    """Code blocks in one of the languages, without their indentation."""
    for indent, language, code in FENCE.findall(text):
        if language in languages:
            yield "\n".join(line.removeprefix(indent) for line in code.splitlines())


def commands(text: str) -> Iterator[list[str]]:
    """The words of each ``maslam`` command in a page's shell blocks."""
    for block in blocks(text, "sh", "bash"):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words[:1] == ["maslam"]:
                yield words[1:]


def unknown_words(words: list[str]) -> list[str]:
    """What the parser of a command does not know: the command, an action, an option."""
    if words[0].startswith("-"):
        return []
    if words[0] not in COMMANDS:
        return words[:1]
    known = {parser.prog: parser for parser in reference.parsers_of(words[0])}
    name = f"maslam {' '.join(words[:2])}"
    parser = known.get(name, known[f"maslam {words[0]}"])
    options = {option for action in parser._actions for option in action.option_strings}
    return [word for word in words[1:] if re.match(r"--?[a-z]", word) and word.partition("=")[0] not in options]


@ALL_PAGES
def test_links_and_anchors_lead_somewhere(page: Path) -> None:
    assert broken_links(page, page.read_text(encoding="utf-8")) == []


@ALL_PAGES
def test_commands_exist(page: Path) -> None:
    found = {" ".join(words): unknown_words(words) for words in commands(page.read_text(encoding="utf-8"))}
    assert {command: unknown for command, unknown in found.items() if unknown} == {}


@ALL_PAGES
def test_python_compiles(page: Path) -> None:
    for block in blocks(page.read_text(encoding="utf-8"), "python"):
        ast.parse(block)


@ALL_PAGES
def test_the_python_face_has_the_names(page: Path) -> None:
    used: set[str] = set()
    for block in blocks(page.read_text(encoding="utf-8"), "python"):
        if "import maslam\n" in block or "maslam." in block.replace("from maslam.", ""):
            used |= set(re.findall(r"(?<![\w.])maslam\.(\w+)", re.sub(r"from maslam\S* import.*", "", block)))
    assert used <= {*maslam.__all__}


@pytest.mark.parametrize(
    ("text", "broken"),
    [
        ("[a](README.md) [b](docs/tutorial.md#1-images) ![c](docs/pictures/demo.png) [d](https://example.org)", []),
        ("[a](absent.md)", ["absent.md"]),
        ("![a](docs/absent.png)", ["docs/absent.png"]),
        ("# One\n[a](#one) [b](#two)", ["#two"]),
        ("```sh\n[a](absent.md)\n```", []),
    ],
)
def test_the_link_checker(text: str, broken: list[str]) -> None:
    assert broken_links(ROOT / "page.md", text) == broken


@pytest.mark.parametrize(
    ("line", "unknown"),
    [
        ("maslam slam drive/ out/ --agents 4  # a comment", []),
        ("maslam netvlad eval --sets a --places.thresold 1", ["--places.thresold"]),
        ("maslam slam drive/ out/ --places.thresold=1", ["--places.thresold=1"]),
        ("maslam slamm drive/", ["slamm"]),
    ],
)
def test_the_command_checker(line: str, unknown: list[str]) -> None:
    (words,) = commands(f"```sh\n{line}\n```")
    assert unknown_words(words) == unknown


def test_every_dependency_has_a_line_in_the_readme() -> None:
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = {key: value for key, value in project["optional-dependencies"].items() if key != "dev"}
    wanted = [re.split(r"[<>=\[]", text)[0] for texts in (project["dependencies"], *extras.values()) for text in texts]
    rows = " ".join(line for line in (ROOT / "README.md").read_text(encoding="utf-8").splitlines() if line[:1] == "|")
    assert [name for name in wanted if name not in rows] == []
