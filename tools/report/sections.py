"""The report's contents, section by section."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np

from ..common.figures import INK, TRUTH, colour_of, dash_of
from ..common.text_table import counted
from .charts import (
    OPERATION_COLOUR,
    OPERATIONS,
    Path2D,
    TopView,
    axes_of,
    bars,
    bytes_chart,
    copy_chart,
    format_bytes,
    lines_chart,
    map_chart,
    top_view,
    traffic_matrix,
)
from .coverage_table import coverage_sections, in_one_frame, percent_text
from .earlier_lines import earlier_sections
from .graph_warnings import warning_sections
from .html import Section, Tile, legend, table
from .load_table import load_table
from .match_images import sample_images
from .measured import frames_read, measured_on, table_note
from .run_data import AgentData, RunData
from .summary_table import who_decided, why_text
from .truth_warnings import truth_sections
from .undecided_warnings import undecided_sections

MAX_MATCH_ROWS = 400


def headline(run: RunData) -> tuple[str, str]:
    """Title and the line below it."""
    s = run.summary
    title = f"{counted(s['agents'], 'agent')} in {Path(run.manifest.source).name}"
    settings = f"{who_decided(s)}, seed {s['seed']}, scale {run.manifest.scale}"
    errors = f" · errors {measured_on(s)}" if measured_on(s) else ""
    return title, f"{run.manifest.kind} · {s['keyframes']} key-frames · {settings} · maslam {s['version']}{errors}"


def tiles(run: RunData) -> list[Tile]:
    """The key figures; green and red only where there was something to gain."""
    s = run.summary
    together, of, without = in_one_frame(s)
    shared = "good" if together == of > 1 else "bad" if without else ""
    apart = f"without a place: {', '.join(without)}" if without else ""
    accepted, false = s["matches"]["accepted"], s["matches"]["false_accepted"]
    known = "truth unknown" if false is None else f"{false} of them false"
    judged = "" if false is None or not accepted else "bad" if false else "good"
    exploration = s["exploration_percent"]
    total = s["traffic"]["total"]
    return [
        *_error_tiles(run),
        *_placed_tile(run),
        Tile("agents in one frame", f"{together} of {of}", apart, shared),
        Tile("accepted matches", str(accepted), known, judged),
        Tile(
            "exploration, mean", percent_text(float(np.mean(exploration))), f"minimum {percent_text(min(exploration))}"
        ),
        Tile("bytes sent", format_bytes(total["wire_bytes"]), f"{format_bytes(total['payload_bytes'])} payload"),
        Tile("time of the agents", f"{run.timing['wall_s']:.1f} s", f"{run.timing['realtime_factor']:.1f} x real time"),
    ]


def _error_tiles(run: RunData) -> list[Tile]:
    after, before = run.summary["ate_rmse_m"]["mean_agents"], run.summary["odometry_mean_rmse_m"]
    paths = [p for p in run.summary["path_length_m"] if p]
    if after is None:
        return [
            Tile("mean ATE", "unknown", "no ground truth" if not run.has_truth else "too few poses with a true one")
        ]
    better = before is not None and after < before
    share = f" ({100 * after / np.mean(paths):.2f} % of the path)" if paths else ""
    alone = "" if before is None else f"odometry alone {before:.3f} m"
    return [Tile(f"mean ATE{share}", f"{after:.3f} m", alone, "good" if better else "")]


def _placed_tile(run: RunData) -> list[Tile]:
    """Frames with a place; red where more than a tenth of those read have none."""
    coverage = run.summary.get("coverage") or []
    if not coverage:
        return []
    placed, read = sum(c["placed"] for c in coverage), frames_read(run.summary)
    mood = "bad" if placed < 0.9 * read else ""
    return [Tile("frames placed", percent_text(100.0 * placed / max(read, 1)), f"{placed} of {read} read", mood)]


def sections(run: RunData) -> list[Section]:
    """The whole report."""
    return [
        *truth_sections(run.summary),
        *warning_sections(run.summary),
        *undecided_sections(run.summary),
        *_map(run),
        *earlier_sections(run.summary),
        *coverage_sections(run.summary),
        _copies(run),
        _errors(run),
        _bytes(run),
        _exploration(run),
        _images(run),
        _matches(run),
        _pairs(run),
        Section("Settings", "", f"<details><summary>config.yaml</summary><pre>{escape(run.config)}</pre></details>"),
    ]


def _agent_legend(run: RunData) -> str:
    names = [(agent.name, colour_of(agent.index), dash_of(agent.index)) for agent in run.agents]
    return legend([("ground truth", TRUTH, ()), *names] if run.has_truth else names)


def _map(run: RunData) -> list[Section]:
    """One chart of all that the truth relates; the others by frame, since nothing relates two frames."""
    note = "Top view. Dark links join the two places of each accepted match."
    laid = [agent.index for agent in run.agents if run.is_aligned(agent.index)]
    apart = [group for group in run.groups if group[0] not in laid and any(len(run.in_world[i]) for i in group)]
    if laid:
        note += " One transform lays each group of agents that shares a frame on the ground truth."
    if apart:
        without = "They have too little of it" if laid else "There is no ground truth"
        note += f" {without}: each {'other ' if laid else ''}group of agents is drawn in its own frame."
    if any(run.unit(group[0]) != "metres" for group in apart):
        note += " With one camera alone, a frame's unit of length is its own and no metre."
    shown = ([laid] if laid else []) + sorted(apart, key=lambda group: (-len(group), group))
    charts = [_map_of(run, group) for group in shown]
    return [Section(_map_title(run), note, _agent_legend(run) + "".join(charts))]


def _map_title(run: RunData) -> str:
    together, of, _ = in_one_frame(run.summary)
    if len(run.agents) == 1:
        return "Trajectory"
    if len(run.groups) > 1:
        return f"Agents in {len(run.groups)} frames that no match joins"
    return "All agents in one frame" if together == of else f"{together} of {of} agents in one frame"


def _map_of(run: RunData, members: list[int]) -> str:
    return f'<div class="wide">{map_chart(top_view(run, members), run.unit(members[0]))}</div>'


def _copies(run: RunData) -> Section:
    """A small map for each holder: its own trajectory and the copies it bought."""
    figures = []
    for agent in run.agents:
        error = run.summary["ate_rmse_m"]["maps"][agent.index]
        measured = "" if error is None else f", ATE of all {error:.3f} m"
        caption = f"holds {len(agent.copies)} of {len(run.agents) - 1}{measured}"
        chart = copy_chart(agent.name, _held(run, agent))
        head = f'<h3 style="color:{colour_of(agent.index)}">{escape(agent.name)}</h3>'
        figures.append(f"<figure>{head}{chart}<figcaption>{escape(caption)}</figcaption></figure>")
    note = "Final maps: each agent's own key-frames and the map copies it bought from others, in its own frame."
    return Section("Map copies", note, f'<div class="copies">{"".join(figures)}</div>')


def _held(run: RunData, agent: AgentData) -> TopView:
    pieces = [(agent.index, agent.estimate), *sorted(agent.copies.items())]
    axes, T = axes_of(run, [agent.index]), run.alignment(pieces)
    paths = [Path2D(run.agents[i].name, (T @ t.centres)[:, axes], i, faint=i != agent.index) for i, t in pieces]
    truths = [run.agents[i].truth for i, _ in pieces] if run.is_aligned(agent.index) else []
    return TopView(paths, [truth.centres[:, axes] for truth in truths if truth is not None])


def _errors(run: RunData) -> Section:
    times = run.timeline.get("time_s", np.zeros(0))
    own = {agent.name: run.timeline[f"ate_rmse_m_{agent.name}"] for agent in run.agents}
    maps = {agent.name: run.timeline[f"map_rmse_m_{agent.name}"] for agent in run.agents}
    if not run.has_truth or not len(times):
        return Section("Error over time", "There is no ground truth to measure against.", "")
    charts = [
        f"<div><h3>{title}</h3>{lines_chart(times, series, label, run.optimised_s)}</div>"
        for title, series, label in (
            ("Own trajectory so far", own, "ATE RMSE, m"),
            ("Own map and all copies held", maps, "ATE RMSE, m"),
        )
    ]
    note = f"Position error{_after(run)} of the key-frames that each agent had at that moment. "
    note += f"The table's errors are {table_note(run.summary)}Dotted lines: an optimisation ended."
    mean: list[tuple[str, str, tuple[int, ...]]] = [("mean", INK, ())] if len(run.agents) > 1 else []
    key = legend([(a.name, colour_of(a.index), dash_of(a.index)) for a in run.agents] + mean)
    return Section("Error over time", note, f'{key}<div class="columns">{"".join(charts)}</div>{_error_table(run)}')


def _after(run: RunData) -> str:
    known = [a for a in (run.summary.get("alignments") or {}).get("agents") or [] if a is not None]
    return f" after {known[0]['kind']} alignment," if known else ","


def _error_table(run: RunData) -> str:
    s = run.summary
    columns = [
        s["path_length_m"],
        s["odometry_rmse_m"],
        s["ate_rmse_m"]["agents"],
        s["ate_mean_m"]["agents"],
        s["ate_rmse_m"]["maps"],
        s["ate_rmse_m"]["connected"],
    ]
    head = ["agent", "path", "odometry ATE", "ATE", "ATE, mean error", "maps held", "in the shared frame"]
    rows = [
        [escape(a.name), *("–" if c[a.index] is None else f"{c[a.index]:.3f} m" for c in columns)] for a in run.agents
    ]
    return f'<div class="scroll">{table(head, rows)}</div>'


def _bytes(run: RunData) -> Section:
    times = run.timeline.get("time_s", np.zeros(0))
    bands = {name: run.timeline[f"{name}_wire_bytes"] for name in OPERATIONS} if len(times) else {}
    rows = []
    for name in (*OPERATIONS, "total"):
        one = run.summary["traffic"][name]
        title = escape(OPERATIONS.get(name, name))
        rows.append([title, f"{one['messages']:,}", f"{one['payload_bytes']:,}", f"{one['wire_bytes']:,}"])
    key = legend([(title, OPERATION_COLOUR[name], ()) for name, title in OPERATIONS.items()])
    chart = bytes_chart(times, bands) if len(times) else ""
    note = "Payload is counted as in published tables; wire bytes are the exact length of every encoded message."
    parts = table(["operation", "messages", "payload bytes", "wire bytes"], rows, total=True)
    columns = f'<div class="columns"><div>{key}{chart}</div><div>{parts}{load_table(run)}</div></div>'
    return Section("Bytes by operation", note, columns)


def _exploration(run: RunData) -> Section:
    exploration = run.summary["exploration_percent"]
    shares = {agent.index: exploration[agent.index] for agent in run.agents}
    entries = [(a.name, shares[a.index], percent_text(shares[a.index]), colour_of(a.index)) for a in run.agents]
    note = (
        "Frames with a place in an agent's own map or in a copy it holds, over all frames that all agents have read, "
        "each frame counted once. Of a copy the frames between neighbouring key-frames count that are both in it."
    )
    return Section("Exploration", note, bars(entries, 100.0))


def _images(run: RunData) -> Section:
    images, reason = sample_images(run)
    figures = []
    for one in images:
        row = one.row
        ends = [
            f"agent_{int(row[f'{end}_agent']):02d} key-frame {row[f'{end}_keyframe']}" for end in ("query", "match")
        ]
        caption = f"{ends[0]} at {ends[1]}: {row['inliers']} map points agree"
        pair = f'<img src="{one.query}" alt="query image"><img src="{one.match}" alt="matched image">'
        figures.append(f'<figure><div class="pair">{pair}</div><figcaption>{escape(caption)}</figcaption></figure>')
    note = reason or "Left the query, right the place it was recognised as."
    return Section(
        "Images of accepted matches", note, f'<div class="pairs">{"".join(figures)}</div>' if figures else ""
    )


def _matches(run: RunData) -> Section:
    matches = run.summary["matches"]
    counts = [("accepted", matches["accepted"], "#009E73")]
    counts += [(f"rejected: {reason}", count, "#9aa7b3") for reason, count in matches["rejected"].items()]
    counts += [(f"skipped: {reason}", count, "#d5dbe1") for reason, count in matches.get("skipped", {}).items()]
    most = max(count for _, count, _ in counts)
    outcomes = bars([(name, count, str(count), colour) for name, count, colour in counts], most)
    head = ["time", "query", "match", "distance", "outcome", "why", "matches", "inliers", "error"]
    shown = sorted(run.matches, key=lambda row: (row["outcome"] != "accepted", float(row["time_s"])))[:MAX_MATCH_ROWS]
    listing = f'<div class="scroll">{table(head, [_match_cells(row) for row in shown], text_columns=3)}</div>'
    hidden = len(run.matches) - len(shown)
    more = f"{hidden} more rows stand in matches.csv." if hidden else ""
    note = f"{matches['candidates']} candidate pairs, {matches['verified']} passed the geometric check. "
    note += (
        "Rejected ones were checked and failed. Skipped ones were not checked: they are known or close to a match that "
    )
    note += "is there"
    same = matches.get("same_image", 0)
    note += f", or of one and the same image, which is no evidence ({same}). " if same else ". "
    if matches.get("wider"):
        note += f"{matches['wider']} were verified beyond the strict distance, while agents or tracks were apart"
        note += f" ({matches.get('wider_traffic', {}).get('wire_bytes', 0):,} bytes). "
    note += more
    return Section("Candidate matches and their outcome", note, outcomes + listing)


def _match_cells(row: dict[str, str]) -> list[str]:
    false = row["false"] == "1"
    outcome = "false" if false else row["outcome"]
    label = "accepted, but false" if false else row["outcome"]
    ends = [f"agent_{int(row[f'{end}_agent']):02d} · {row[f'{end}_keyframe']}" for end in ("query", "match")]
    error = f"{float(row['error_m']):.2f} m" if row["error_m"] else "–"
    why = escape(why_text(row))
    badge = f'<span class="outcome {outcome}">{escape(label)}</span>'
    return [f"{float(row['time_s']):.1f} s", *ends, row["distance"], badge, why, row["matches"], row["inliers"], error]


def _pairs(run: RunData) -> Section:
    names = [agent.name for agent in run.agents]
    note = "Bytes sent from the agent of the row to the agent of the column."
    return Section(
        "Bytes between agents", note, f'<div class="scroll">{traffic_matrix(names, run.traffic_matrix())}</div>'
    )
