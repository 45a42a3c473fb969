"""``maslam slam``: from a folder of images to a report, in one go."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.folders import check_apart
from ..common.options import read_settings
from ..common.progress import Progress, counter, progress_on
from .predecessor import SEQUENCES
from .preprocess import preprocess, summary_line
from .preprocess_options import (
    READING,
    SECTION,
    SECTIONS,
    PreprocessSettings,
    add_preprocess_arguments,
    settings_from,
)
from .run import add_onto_argument, add_run_arguments, config_from, earlier_run, joined

if TYPE_CHECKING:
    from maslam.mas.config import MasConfig
    from maslam.mas.policies.foreign import PolicyLike
    from maslam.mas.transport.choice import TransportLike


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``SRC OUT`` and the options of ``preprocess`` and ``run``."""
    parser.add_argument(
        "source",
        metavar="SRC",
        type=Path,
        help="images, film or bag; `maslam inspect SRC` shows what is read",
    )
    parser.add_argument(
        "out",
        metavar="OUT",
        type=Path,
        help="for the results: a new folder, or an earlier run of the same source and settings, which is gone on with "
        f"or made anew; OUT/{SEQUENCES} holds the agent sequences",
    )
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help=f"YAML with settings of `run`, `{SECTION}: {{...}}`, `{READING}: {{...}}`",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.add_argument("--json", action="store_true", help="print the figures, as in OUT/summary.json, as one object")
    add_onto_argument(parser)
    add_preprocess_arguments(parser)
    add_run_arguments(parser)


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    from maslam.mas.config import MasConfig

    from ..report.summary_table import json_of, table_of

    content = read_settings(arguments.config, (*SECTIONS, *MasConfig.model_fields))
    settings = settings_from(arguments, content)
    config = config_from(arguments, {key: value for key, value in content.items() if key not in SECTIONS})
    with progress_on(quiet=arguments.quiet) as progress:
        page = slam(arguments.source, arguments.out, settings, config, progress, onto=arguments.onto)
    print(json_of(arguments.out) if arguments.json else f"{table_of(arguments.out)}\n\nreport: {page}")


def slam(
    source: Path,
    out: Path,
    settings: PreprocessSettings,
    config: MasConfig,
    progress: Progress,
    policy: PolicyLike | None = None,
    transport: TransportLike | None = None,
    onto: Path | None = None,
) -> Path:
    """Preprocess ``source``, run the agents, write ``out`` and its report; returns the report's page.

    ``policy``, ``transport``: a user's own instead of those that ``config`` names; ``onto``: an earlier run.
    """
    from maslam.mas.kernels import agent_kernels
    from maslam.mas.output.run_folder import check_out
    from maslam.mas.sequence import load_sequences
    from maslam.mas.simulation import run

    from ..common.compiling import compile_for
    from ..common.writing import writing
    from ..report.command import write_report
    from .earlier_result import check_same_run, of_manifest

    check_apart(source, out)
    check_out(out)
    earlier = earlier_run(onto, out)
    if not settings.overwrite:
        check_same_run(out, config)
    with writing(out):
        manifest = preprocess(source, out / SEQUENCES, settings, progress, judged_later=True)
        whole = joined(earlier, manifest)
        if not settings.overwrite:
            check_same_run(out, config, of_manifest(whole))
        progress.say(summary_line(manifest, out / SEQUENCES))
        compile_for(agent_kernels(len(whole.agents)), progress)
        shown = counter(progress, "agents")
        run(*load_sequences(out / SEQUENCES), config, out, shown, policy, transport, earlier)
        return write_report(out)
