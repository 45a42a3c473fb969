"""The generated reference leaves nothing out, and the diagrams are what their script draws."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import diagrams
import file_formats
import pytest
import python_reference
import reference
from pydantic import BaseModel

import maslam
from maslam.backend.config import RelPoseConfig, SolverConfig
from maslam.frontend.config import OdometryConfig
from maslam.mas.config import MasConfig
from maslam.mas.contracts.contract import CONTRACTOR_SENDS, MANAGER_SENDS, ContractState
from maslam.mas.evaluation.summary import Summary, Timing
from maslam.mas.manifest import Manifest
from maslam.mas.output.run_folder import Recorder
from maslam.mas.protocol.accounting import Traffic
from maslam.tools.cli import COMMANDS
from maslam.tools.common.options import leaves, option_name

ROOT = Path(__file__).resolve().parents[2]
PAGES = reference.pages()


@pytest.mark.parametrize(
    ("model", "prefix"),
    [(MasConfig, ""), (OdometryConfig, "odometry"), (RelPoseConfig, "relpose"), (SolverConfig, "solver")],
)
def test_every_setting_has_a_row(model: type[BaseModel], prefix: str) -> None:
    page = PAGES["reference/settings.md"]
    assert [path for path, _ in leaves(model, prefix) if f"| `{option_name(path)}` |" not in page] == []


def test_every_setting_has_values_a_default_and_a_meaning() -> None:
    rows = [row for section in reference.all_settings().values() for row in section.rows.values()]
    assert [row[0] for row in rows if not all(row)] == []


def test_every_command_and_option_is_told() -> None:
    page = PAGES["reference/commands.md"]
    for parser in reference.parsers():
        section = section_of_page(page, parser.prog) + section_of_page(page, "Every command")
        own = [a for a in parser._actions if not reference.is_setting(a) and a.option_strings and a.dest != "help"]
        assert [a.option_strings[0] for a in own if a.option_strings[0] not in section] == []
    assert all(f"\n## maslam {name}\n" in page for name in COMMANDS)


def section_of_page(page: str, title: str) -> str:
    return page.split(f"\n## {title}\n")[1].split("\n## ")[0]


def test_links_between_the_generated_pages_have_their_headings() -> None:
    anchors = {reference._anchor(title) for title in re.findall("^## (.+)$", PAGES["reference/settings.md"], re.M)}
    assert set(re.findall(r"settings\.md#([\w-]+)", PAGES["reference/commands.md"])) <= anchors


def test_every_public_name_is_told_with_its_docstring() -> None:
    page = PAGES["reference/python.md"]
    for name in python_reference.public_names():
        assert f"\n### maslam.{name}\n" in page
        assert python_reference.prose(getattr(maslam, name)), name


def test_docstrings_become_markdown() -> None:
    text = "Read ``agent_<n>`` of :class:`~maslam.Run` < 3."
    text += "\n\nArgs:\n    out: a folder,\n        made new.\n    n: how many.\n"
    told = python_reference.as_markdown(text)
    assert told.startswith("Read `agent_<n>` of `maslam.Run` &lt; 3.")
    assert told.endswith("**Args**\n\n- out: a folder,\n  made new.\n- n: how many.")


def columns(path: Path) -> list[str]:
    with open(path, encoding="utf-8", newline="") as file:
        return next(csv.reader(file))


def test_every_column_of_a_run_has_a_meaning(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.begin_timeline(2)
        recorder.matches([], {})
    assert columns(tmp_path / "run/matches.csv") == list(file_formats.MATCHES)
    assert columns(tmp_path / "run/traffic.csv") == list(file_formats.TRAFFIC)
    operations = "|".join(traffic.value for traffic in Traffic)
    told = [re.sub(rf"^({operations})_", "OPERATION_", name) for name in columns(tmp_path / "run/timeline.csv")]
    told = [re.sub(r"agent_\d\d$", "agent_NN", name) for name in told]
    assert list(dict.fromkeys(told)) == list(file_formats.TIMELINE)


def test_every_event_has_a_meaning() -> None:
    kinds: set[str] = set()
    for path in (ROOT / "mas").rglob("*.py"):
        kinds |= set(re.findall(r"\bevent\(\s*\"(\w+)\"", path.read_text(encoding="utf-8")))
    assert kinds == set(file_formats.EVENTS)


@pytest.mark.parametrize("model", [Summary, Manifest, Timing])
def test_every_key_of_the_json_files_has_a_row(model: type[BaseModel]) -> None:
    page = PAGES["reference/files.md"]
    names = {key for schema in objects(model.model_json_schema()) for key in schema["properties"]}
    assert names >= set(model.model_fields)
    assert [name for name in sorted(names) if f"| `{name}` |" not in page] == []


def objects(schema: Any) -> Iterator[dict[str, Any]]:
    """Every schema inside ``schema`` that has properties."""
    if isinstance(schema, dict):
        if "properties" in schema:
            yield schema
        for inner in schema.values():
            yield from objects(inner)


@pytest.mark.parametrize("name", diagrams.DRAWINGS)
def test_the_diagrams_are_what_the_script_draws(name: str) -> None:
    drawn = diagrams.DRAWINGS[name]().svg()
    assert (diagrams.PICTURES / name).read_text(encoding="utf-8") == drawn, "run python docs/scripts/diagrams.py"


def test_the_state_machine_shows_every_state_and_message() -> None:
    drawn = diagrams.contract_states().svg()
    words = {message.__name__ for _, message in {**CONTRACTOR_SENDS, **MANAGER_SENDS}} | {str(s) for s in ContractState}
    assert [word for word in words if f">{word}<" not in drawn] == []
