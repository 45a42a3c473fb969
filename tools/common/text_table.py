"""Tables of text for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def counted(number: int, noun: str) -> str:
    """``"1 agent"``, ``"2 agents"``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def kinds_text(frames: Mapping[str, int]) -> str:
    """Frames by kind of reason, most frequent first: ``too dark (3 frames); too few points (1 frame)``; one kind alone
    without its number."""
    ranked = sorted(frames.items(), key=lambda entry: -entry[1])
    return "; ".join(f"{kind} ({counted(n, 'frame')})" if len(ranked) > 1 else kind for kind, n in ranked)


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """One line per row: the first column set left, the others right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for first, *others in rows:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        lines.append("  ".join([first.ljust(widths[0]), *cells]).rstrip())
    return lines
