"""The HTML around a report's charts: one file, everything in it, no address outside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path


@dataclass(frozen=True)
class Tile:
    """One key figure: ``mood`` is "", "good" or "bad"."""

    label: str
    value: str
    detail: str = ""
    mood: str = ""


@dataclass(frozen=True)
class Section:
    """A titled part of the page: a sentence for people, then finished HTML."""

    title: str
    note: str
    body: str


def page(title: str, subtitle: str, tiles: Sequence[Tile], sections: Sequence[Section]) -> str:
    """The whole document."""
    style = Path(__file__).with_name("report.css").read_text(encoding="utf-8")
    parts = [
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>',
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{style}</style></head>',
        "<body><main>",
        f"<header><h1>{escape(title)}</h1><p>{escape(subtitle)}</p></header>",
        f'<div class="tiles">{"".join(_tile(tile) for tile in tiles)}</div>',
    ]
    for section in sections:
        note = f'<p class="note">{escape(section.note)}</p>' if section.note else ""
        parts.append(f"<section><h2>{escape(section.title)}</h2>{note}{section.body}</section>")
    return "\n".join([*parts, "</main></body></html>\n"])


def table(head: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int = 1, total: bool = False) -> str:
    """HTML table of finished cells; the first ``text_columns`` are set left; ``total`` marks the last row."""

    def cells(tag: str, values: Sequence[str]) -> str:
        left = ' class="text"'
        return "".join(f"<{tag}{left if i < text_columns else ''}>{value}</{tag}>" for i, value in enumerate(values))

    marks = ["" for _ in rows]
    if total:
        marks[-1] = " class=total"
    body = "".join(f"<tr{mark}>{cells('td', row)}</tr>" for mark, row in zip(marks, rows, strict=True))
    return f"<table><tr>{cells('th', head)}</tr>{body}</table>"


def legend(entries: Sequence[tuple[str, str, Sequence[int]]]) -> str:
    """HTML of a legend that charts share: name, colour and line pattern (empty: solid) each."""
    items = []
    for name, colour, dash in entries:
        stroke = f'stroke="{colour}" stroke-width="3" stroke-dasharray="{" ".join(map(str, dash)) or "none"}"'
        items.append(f'<span><svg width="26" height="10"><path d="M1 5H25" {stroke}/></svg>{escape(name)}</span>')
    return f'<div class="legend">{"".join(items)}</div>'


def _tile(tile: Tile) -> str:
    detail = f"<em>{escape(tile.detail)}</em>" if tile.detail else ""
    mood = f" {tile.mood}" if tile.mood else ""
    return f'<div class="tile{mood}"><span>{escape(tile.label)}</span><b>{escape(tile.value)}</b>{detail}</div>'
