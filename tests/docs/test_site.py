"""The site builds without a warning and asks no other host for anything."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DISTANT = re.compile(r"""<(?:script|link|img|iframe)[^>]*(?:src|href)=["']?(?:https?:)?//""")


@pytest.mark.slow
def test_the_site_builds_and_fetches_nothing(tmp_path: Path) -> None:
    pytest.importorskip("material", reason="the extra docs is not installed")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    built = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    pages = sorted((tmp_path / "site").rglob("*.html"))
    assert len(pages) > 30
    assert [page.name for page in pages if DISTANT.search(page.read_text(encoding="utf-8"))] == []


def test_the_checker_of_other_hosts() -> None:
    assert DISTANT.search('<script src="https://example.org/a.js">')
    assert DISTANT.search("<link rel=stylesheet href=//example.org/a.css>")
    assert not DISTANT.search('<a href="https://example.org">')
    assert not DISTANT.search('<script src="assets/a.js">')
