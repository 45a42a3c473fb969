"""The tables of a sweep as Markdown: the thesis's chapter 4 beside ours, and each run against its reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from .plan import TOWN
from .rows import Group, Spread
from .thesis import TABLES, TOWN_DVPR_MB, TOWN_REST_MB, Printed

_COLUMNS: list[tuple[str, str, str]] = [
    ("ATE agents, m", "ate_agents", "ate_agents"),
    ("ATE maps, m", "ate_maps", "ate_maps"),
    ("DVPR, MB", "payload_dvpr", "dvpr"),
    ("RelPose, MB", "payload_relpose", "relpose"),
    ("DOpt, MB", "payload_dopt", "dopt"),
    ("maps, MB", "payload_mapmerge", "mapmerge"),
    ("exploration, %", "exploration", "exploration"),
]


def report(groups: Sequence[Group]) -> str:
    """All tables, one after the other."""
    parts = ["# Sweep", _HOW]
    for preset in dict.fromkeys(group.preset for group in groups):
        number, printed = TABLES.get(preset, ("", {}))
        title = f"## Preset {preset}" + (f": the thesis's Table {number}" if number else "")
        chosen = [group for group in groups if group.preset == preset]
        parts += [title, _thesis_table(chosen, printed), _true_table(chosen)]
    return "\n\n".join([*parts, *_directions(groups), *_town(groups)]) + "\n"


_HOW = (
    "Mean over the seeds ± half their range. Bytes in the first table of a preset are payload, as published; in the "
    "second the bytes sent (wire). In brackets: what the thesis prints. MB = 10^6 bytes."
)


def _thesis_table(groups: Sequence[Group], printed: dict[tuple[str, int], Printed]) -> str:
    heads = ["sequence", "agents", *(name for name, _, _ in _COLUMNS)]
    lines = []
    for group in groups:
        theirs = printed.get((group.sequence, group.agents))
        cells = [
            _text(group[ours]) + (f" ({getattr(theirs, field):g})" if theirs else "") for _, ours, field in _COLUMNS
        ]
        lines.append([group.sequence, str(group.agents), *cells])
    return markdown(heads, lines)


def _true_table(groups: Sequence[Group]) -> str:
    figures: list[tuple[str, Callable[[Group], str]]] = [
        ("key-frames", lambda g: str(g.rows[0].keyframes)),
        ("odometry, m", lambda g: _text(g["odometry"], 3)),
        ("ATE, m", lambda g: _text(g["ate_agents"], 3)),
        ("reference, m", lambda g: _text(g["reference_ate"], 3)),
        ("regret", lambda g: _text(g["regret_ate"], 3)),
        ("wire, MB", lambda g: _text(g["wire_total"])),
        ("of it maps", lambda g: _text(g["wire_mapmerge"])),
        ("points per key-frame", lambda g: _text(g["points_per_keyframe"], 0)),
        ("off, m", lambda g: _text(g["points_off_m"], 3)),
        ("reference, MB", lambda g: _text(g["reference_mb"])),
        ("exploration of possible, %", lambda g: _text(g["exploration_of_possible"], 1)),
        ("in one frame", lambda g: f"{min(r.largest_group for r in g.rows)} of {g.agents}"),
        ("matches (false)", lambda g: f"{_text(g['accepted'], 0)} ({_text(g['false_accepted'], 0)})"),
        ("s", lambda g: _text(g["wall_s"], 1)),
    ]
    heads = ["sequence", "agents", *(name for name, _ in figures)]
    return markdown(heads, [[g.sequence, str(g.agents), *(figure(g) for _, figure in figures)] for g in groups])


def _directions(groups: Sequence[Group]) -> list[str]:
    """The thesis's statements on its systems, each against the one before it (4.3, 4.4), and of clusters (2.2.3)."""
    by_preset = {(g.sequence, g.agents, g.preset): g for g in groups}
    lines = []
    for sequence, agents in dict.fromkeys((g.sequence, g.agents) for g in groups):
        predecessor, default, optimised, selection = (
            by_preset.get((sequence, agents, name)) for name in ("predecessor", "default", "optimised", "selection")
        )
        found = [
            _ratio(optimised, default, "exploration"),
            _ratio(selection, optimised, "payload_dvpr"),
            _ratio(selection, optimised, "accepted"),
            _ratio(default, predecessor, "payload_dvpr"),
        ]
        if any(ratio is not None for ratio in found):
            lines.append([sequence, str(agents), *("-" if ratio is None else f"{ratio:.2f}" for ratio in found)])
    heads = [
        "sequence",
        "agents",
        "exploration: optimised / default",
        "DVPR bytes: selection / optimised",
        "accepted matches: selection / optimised",
        "DVPR bytes: default / predecessor",
    ]
    return ["## The thesis's systems beside each other", markdown(heads, lines)] if lines else []


def _ratio(group: Group | None, other: Group | None, name: str) -> float | None:
    """Of two presets' means."""
    ours, theirs = (None if g is None else g[name] for g in (group, other))
    return ours.mean / theirs.mean if ours is not None and theirs is not None and theirs.mean else None


def _town(groups: Sequence[Group]) -> list[str]:
    chosen = [group for group in groups if group.sequence == TOWN]
    if not chosen:
        return []
    lines = [
        [g.preset, str(g.agents), _text(g["payload_dvpr"]), _text(g["wire_total"]), _text(g["regret_ate"], 3)]
        for g in chosen
    ]
    heads = ["preset", "agents", f"DVPR, MB ({TOWN_DVPR_MB:g})", "all, MB sent", "ATE regret"]
    note = f"Thesis, section 4.6: {TOWN_DVPR_MB:g} MB for place recognition, {TOWN_REST_MB:g} for RelPose and DOpt."
    return ["## The town", note, markdown(heads, lines)]


def markdown(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A table."""
    rows = [heads, ["---"] * len(heads), *lines]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _text(value: Spread | None, digits: int = 2) -> str:
    return "-" if value is None else value.text(digits)
