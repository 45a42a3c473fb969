"""``maslam team``: all agents of a folder as processes on this machine, over a real network, to one RUN folder."""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.folders import check_apart
from ..common.options import read_settings
from ..common.progress import Progress, progress_on
from ..pipeline.predecessor import SEQUENCES
from ..pipeline.preprocess import preprocess, summary_line
from ..pipeline.preprocess_options import SECTIONS, add_preprocess_arguments, settings_from
from ..pipeline.run import add_run_arguments, config_from
from .agent import JOURNAL, add_live_arguments, live_config
from .played_team import LiveTeam, PlayedTeam, RecordedTeam
from .processes import AgentCommand, run_together

if TYPE_CHECKING:
    from maslam.mas.config import MasConfig
    from maslam.mas.live.config import LiveConfig

JOURNALS = "journals"
"""In OUT: a folder for each agent, with its journal; with them an unfinished team goes on."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``SRC OUT``, the options of ``preprocess`` and ``run``, and those of agents on a network."""
    parser.add_argument("source", metavar="SRC", type=Path, help="images, film or bag, or a folder of agent sequences")
    parser.add_argument(
        "out",
        metavar="OUT",
        type=Path,
        help="for the results, as `maslam slam` writes them: a new folder, or an earlier run of the same source and "
        "settings; one that was ended early goes on from its agents' journals",
    )
    parser.add_argument("--over", choices=["tls", "quic"], default="tls", help="kind of links (default: %(default)s)")
    parser.add_argument("--config", type=Path, metavar="FILE", help="YAML with settings, as for `maslam slam`")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.add_argument("--json", action="store_true", help="print the figures, as in OUT/summary.json, as one object")
    parser.add_argument(
        "--live",
        action="store_true",
        help="each sequence of SRC is played at its rate to an agent that tracks it while it negotiates (default: "
        "images are preprocessed before)",
    )
    add_live_arguments(parser)
    add_preprocess_arguments(parser)
    add_run_arguments(parser)


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    from maslam.mas.config import MasConfig
    from maslam.mas.live.config import LINKS
    from maslam.mas.live.one_agent import check_live
    from maslam.mas.manifest import MANIFEST, read_manifest
    from maslam.mas.output.run_folder import check_out

    from ..common.writing import writing
    from ..pipeline.earlier_result import check_same_run, of_manifest
    from ..report.command import write_report
    from ..report.summary_table import json_of, table_of

    content = read_settings(arguments.config, (*SECTIONS, *MasConfig.model_fields))
    settings, live = settings_from(arguments, content), live_config(arguments)
    of_run = {key: value for key, value in content.items() if key not in SECTIONS}
    config = config_from(arguments, of_run, LINKS[live.link])
    check_live(config)
    source, out = arguments.source, arguments.out
    check_apart(source, out)
    check_out(out)
    if not settings.overwrite:
        check_same_run(out, config)
    with progress_on(quiet=arguments.quiet) as progress, writing(out):
        if arguments.live:
            live_team = LiveTeam(source, settings, live.speed)
            team: PlayedTeam = live_team
            manifest = live_team.manifest
        else:
            sequences = source
            if not (source / MANIFEST).is_file():
                sequences = out / SEQUENCES
                progress.say(summary_line(preprocess(source, sequences, settings, progress), sequences))
            team, manifest = RecordedTeam(sequences), read_manifest(sequences)
        if settings.overwrite:
            _forget(out)
        else:
            check_same_run(out, config, of_manifest(manifest))
        _play(team, out, config, live, arguments.over, progress)
        page = write_report(out)
    print(json_of(out) if arguments.json else f"{table_of(out)}\n\nreport: {page}")


def _forget(out: Path) -> None:
    """Begin anew, whatever journals say."""
    shutil.rmtree(out / JOURNALS, ignore_errors=True)


def _play(team: PlayedTeam, out: Path, config: MasConfig, live: LiveConfig, over: str, progress: Progress) -> None:
    """Let the agents run, and record what they did."""
    import yaml

    from maslam.mas.live.authority import AUTHORITY_FOLDER, make_team
    from maslam.mas.live.recorded_agent import met_in
    from maslam.mas.live.team_run import record_team
    from maslam.mas.output.run_folder import SUMMARY

    from ..common.compiling import compile_for

    if (out / SUMMARY).exists():
        _forget(out)  # of a run that came to its end
    compile_for(team.kernels, progress)
    numbers = list(range(len(team.totals)))
    folders = [out / JOURNALS / f"agent_{number:02d}" for number in numbers]
    with tempfile.TemporaryDirectory(prefix="maslam-team-") as scratch:
        credentials = make_team(Path(scratch), "team", numbers)
        shutil.rmtree(Path(scratch) / AUTHORITY_FOLDER)  # nobody joins later
        settings = Path(scratch) / "config.yaml"
        content = {**config.model_dump(mode="json"), **team.settings}
        settings.write_text(yaml.safe_dump(content), encoding="utf-8")
        commands = [
            AgentCommand(n, team.source, folders[n], credentials[n], settings, live, over, team.arguments(n))
            for n in numbers
        ]
        started = time.perf_counter()
        cpu_s = run_together(commands, team.counted, team.totals, progress)
        wall_s = time.perf_counter() - started
    journals = [folder / JOURNAL for folder in folders]
    for number, journal in zip(numbers, journals, strict=True):
        never = sorted(set(numbers) - {number} - met_in(journal))
        if never:
            progress.say(f"warning: agent {number} never met {', '.join(f'agent {a}' for a in never)}")
    manifest, sequences = team.played(journals)
    record_team(manifest, sequences, config, journals, out, wall_s, cpu_s)
    for line in team.said(folders):
        progress.say(line)
