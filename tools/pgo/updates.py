"""Figures of a run with matches one by one, for the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from maslam.backend.config import LinkModel
from maslam.backend.distributed.incremental.one_by_one import OneByOne


def figures(found: OneByOne, link: LinkModel) -> dict[str, object]:
    """``first`` and ``anew``: whole solutions, at the start, and with some of the matches for comparison; ``matches``:
    updates. ``largest_excess``: the largest share of F that updates left above its optimum, as the elected robot has
    it."""
    updates, anew = found.updates, list(found.anew.values())
    excess = [u.cost / u.optimum - 1.0 for u in updates if u.optimum > 0]
    return {
        "matches": len(updates),
        "bytes": _of(u.bytes_sent for u in updates),
        "seconds": _of(u.seconds for u in updates),
        "corrected": _of(u.corrected for u in updates),
        "largest_excess": max([0.0, *excess]),
        "first": {"bytes": found.first.bytes_sent, "seconds": found.first.seconds},
        "anew": {
            "solved": len(anew),
            "bytes": _of(a.bytes_sent for a in anew),
            "seconds": _of(a.seconds for a in anew),
        },
        "link": {"delay_s": link.delay_s, "rate_kbit": link.rate_kbit},
    }


def lines(updates: Mapping[str, Any]) -> list[str]:
    """For people."""
    link, anew = updates["link"], updates["anew"]
    first = updates["first"]
    out = [
        f"  links of {link['rate_kbit']:g} kbit/s and {link['delay_s']:g} s; first solution: {first['bytes']} bytes, "
        f"{first['seconds']:.3g} s"
    ]
    if not updates["matches"]:
        return [*out, "  no match came after it"]
    took = f"{updates['bytes']['mean']:.0f} bytes (at most {updates['bytes']['largest']}), "
    took += f"{updates['seconds']['mean']:.3g} s (at most {updates['seconds']['largest']:.3g}) to the answer"
    count = f"{updates['matches']} match{'es'[2 * (updates['matches'] == 1) :]}"
    out.append(f"  {count} one by one, mean: {took}, {updates['corrected']['mean']:.1f} robots")
    if anew["solved"]:
        shares = [updates[key]["mean"] / anew[key]["mean"] for key in ("bytes", "seconds")]
        out.append(
            f"  solved anew with {anew['solved']} of them, mean: {anew['bytes']['mean']:.0f} bytes, "
            f"{anew['seconds']['mean']:.3g} s; an update takes {100 * shares[0]:.2g} % of the bytes, "
            f"{100 * shares[1]:.2g} % of the time"
        )
    return [*out, f"  after each at most {100 * updates['largest_excess']:.2g} % above the elected robot's optimum"]


def _of(numbers: Iterable[float]) -> dict[str, float]:
    """Mean and largest; 0 of none."""
    values = list(numbers)
    return {"mean": sum(values) / max(len(values), 1), "largest": max(values, default=0)}
