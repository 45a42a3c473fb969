"""Hooks of the site: pages that are generated when it is built, and links that only a checkout has."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).resolve().parent))

import reference

_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(((?:\.\./)+[^)#]+)(#[^)]*)?\)")
DOCS = Path(__file__).resolve().parent.parent


def on_files(files: Files, config: Any) -> Files:
    """Add the reference pages."""
    for name, text in reference.pages().items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Leave only the text of links to files outside the documents: they work in a checkout, not on the site."""
    folder = (DOCS / page.file.src_uri).parent

    def inside(found: re.Match[str]) -> str:
        target = (folder / found.group(2)).resolve()
        return found.group(0) if target.is_relative_to(DOCS) else found.group(1)

    return _LINK.sub(inside, markdown)
