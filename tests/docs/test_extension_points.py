"""The pages on extensions name what can be extended: each group of entry points, and a public class for it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import maslam
from maslam.extensions import ExtensionGroup

ROOT = Path(__file__).resolve().parents[2]
CONTRACTS = re.findall(
    r"^class (\w+)", (ROOT / "tests/extensions/contracts.py").read_text(encoding="utf-8"), re.MULTILINE
)


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/howto/extensions.md"])
def test_a_page_names_all_groups_and_public_classes(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line.startswith("|") and "`maslam." in line]
    groups = {group.value for group in ExtensionGroup}
    assert {name for row in rows for name in re.findall(r"`(maslam\.[a-z]+)`", row)} == groups
    bases = {name for row in rows for name in re.findall(r"`maslam\.([A-Z]\w+)`", row)}
    assert len(bases) == len(groups) and bases <= set(maslam.__all__)
    tested = re.findall(r"`(\w+Contract)`", text)
    assert tested in ([], CONTRACTS)
