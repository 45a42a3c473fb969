"""What a release promises in its files: one version, one list of Pythons, hooks and a workflow that run what make
does."""

from __future__ import annotations

import importlib.util
import re
import tomllib
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PYTHONS = ["3.11", "3.12", "3.13"]


def read_yaml(name: str) -> dict[Any, Any]:
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def resolver() -> Any:
    spec = importlib.util.spec_from_file_location("resolve", ROOT / "requirements" / "resolve.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_same_pythons_everywhere() -> None:
    workflow = read_yaml(".github/workflows/ci.yml")
    assert workflow["jobs"]["test"]["strategy"]["matrix"]["python"] == PYTHONS
    assert list(resolver().PYTHONS) == PYTHONS
    named = [
        c.rpartition(" ")[2] for c in PROJECT["classifiers"] if c.startswith("Programming Language :: Python :: 3")
    ]
    assert named == PYTHONS and PROJECT["requires-python"] == f">={PYTHONS[0]}"


def test_the_workflow_runs_what_make_runs() -> None:
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for job in read_yaml(".github/workflows/ci.yml")["jobs"].values():
        for step in job["steps"]:
            assert set(re.findall(r"make (\w+)", step.get("run", ""))) <= targets
            assert re.fullmatch(r"actions/[\w-]+@v\d+", step.get("uses", "actions/none@v0"))
            for script in re.findall(r"requirements/[\w.-]+", step.get("run", "")):
                assert (ROOT / script).is_file()


def test_the_hooks_need_no_address() -> None:
    (repository,) = read_yaml(".pre-commit-config.yaml")["repos"]
    assert repository["repo"] == "local"
    assert [hook["id"] for hook in repository["hooks"]] == ["ruff-check", "ruff-format", "mypy"]
    assert all(hook["language"] == "system" for hook in repository["hooks"])


def test_one_version() -> None:
    citation = read_yaml("CITATION.cff")
    assert str(citation["version"]) == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    released = re.search(r"^## (\S+) \(\d", changelog, re.MULTILINE)  # what is being worked on has no date yet
    assert released is not None and released[1] == PROJECT["version"]


def test_the_changelog_tells_renamed_and_removed_settings() -> None:
    """Every entry of the table of settings of 0.1 stands in a release since."""
    from maslam.tools.common.earlier_settings import SETTINGS_OF_0_1, Removed

    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    release = text.split("\n## 0.1", 1)[0]
    for name, became in SETTINGS_OF_0_1.items():
        assert f"`{name}`" in release, f"{name}: say in the changelog what became of it"
        assert isinstance(became, Removed) or f"`{became.to}`" in release
