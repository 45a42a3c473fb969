"""``maslam run``: the multi-agent system on agent sequences."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maslam._suggestions import did_you_mean

from ..common.errors import UnknownName, UsageError
from ..common.names import check_name
from ..common.options import DEST, add_model_options, build, option_name, read_settings
from ..common.progress import counter, progress_on
from ..common.yaml_lines import place_of

if TYPE_CHECKING:
    from maslam.mas.config import LinkConfig, MasConfig
    from maslam.mas.manifest import Manifest
    from maslam.mas.output.earlier_run import EarlierRun

DEFAULT_PRESET = "maslam"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``SEQS OUT`` and everything that can be set."""
    parser.add_argument("sequences", metavar="SEQS", type=Path, help="folder that `maslam preprocess` or `import` made")
    parser.add_argument(
        "out",
        metavar="OUT",
        type=Path,
        help="for the results: a new folder, or an earlier run of the same sequences and settings, which is replaced",
    )
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="YAML with settings; a run's config.yaml repeats it"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.add_argument("--json", action="store_true", help="print the figures, as in OUT/summary.json, as one object")
    parser.add_argument(
        "--overwrite", action="store_true", help="replace a run in OUT of other sequences or with other settings"
    )
    add_onto_argument(parser)
    add_run_arguments(parser)


def add_onto_argument(parser: argparse.ArgumentParser) -> None:
    """``--onto RUN``."""
    parser.add_argument(
        "--onto",
        type=Path,
        metavar="RUN",
        help="an earlier run, whose agents answer: the new ones find themselves in its map and extend it "
        "(default: begin a new map)",
    )


def earlier_run(onto: Path | None, out: Path) -> EarlierRun | None:
    """The run that a new one in ``out`` is made onto."""
    from maslam.mas.output.earlier_run import read_earlier_run

    if onto is None:
        return None
    if out.resolve() == onto.resolve():
        raise UsageError(f"--onto {onto}: is the folder for the results; choose another one, the earlier run is kept")
    return read_earlier_run(onto)


def joined(onto: EarlierRun | None, manifest: Manifest) -> Manifest:
    """The manifest of the run: with the agents of the earlier one, if there is one."""
    from maslam.mas.output.earlier_run import joined_manifest

    return manifest if onto is None else joined_manifest(onto, manifest)


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """The options shared with ``maslam slam``: all of :class:`maslam.mas.config.MasConfig`."""
    from maslam.mas.policies.presets import preset

    add_model_options(parser, preset(DEFAULT_PRESET))


def config_from(arguments: argparse.Namespace, file: Mapping[str, Any], link: LinkConfig | None = None) -> MasConfig:
    """A preset, changed by the file's keys and then by the options given; the preset itself may stand in either.
    ``link``: settings of messages that get lost, in the place of the preset's."""
    from maslam._replaced import replaced
    from maslam.mas.policies.presets import PRESETS, preset

    given = getattr(arguments, f"{DEST}preset", None)
    name = str(given or file.get("preset") or DEFAULT_PRESET)
    if name not in PRESETS:
        place = f"--preset {name}" if given else f"{place_of(arguments.config, ['preset'])}: preset"
        raise UnknownName(f"{place}: there is no preset '{name}'{did_you_mean(name, PRESETS)}")
    base = preset(name) if link is None else replaced(preset(name), link=link)
    config = build(base, arguments, file, arguments.config)
    _check_extensions(config, arguments)
    return config


def _check_extensions(config: MasConfig, arguments: argparse.Namespace) -> None:
    """Refuse unknown names before the images are tracked."""
    from maslam.mas.policies.presets import check_policy
    from maslam.mas.transport.choice import check_transport

    for name, check in (("policy", check_policy), ("transport", check_transport)):
        given = hasattr(arguments, DEST + name) or arguments.config is None
        place = option_name(name) if given else place_of(arguments.config, [name])
        check_name(place, check, getattr(config, name))


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    from maslam.mas.kernels import agent_kernels
    from maslam.mas.output.run_folder import check_out
    from maslam.mas.simulation import run

    from ..common.compiling import compile_for
    from ..common.writing import writing
    from ..report.summary_table import json_of, table_of
    from .earlier_result import check_same_run, of_manifest
    from .predecessor import sequences_for

    config = config_from(arguments, read_settings(arguments.config))
    check_out(arguments.out)
    onto = earlier_run(arguments.onto, arguments.out)
    with progress_on(quiet=arguments.quiet) as progress, writing(arguments.out):
        manifest, sequences = sequences_for(arguments.sequences, arguments.out, progress, arguments.overwrite)
        whole = joined(onto, manifest)
        if not arguments.overwrite:
            check_same_run(arguments.out, config, of_manifest(whole))
        compile_for(agent_kernels(len(whole.agents)), progress)
        run(manifest, sequences, config, arguments.out, counter(progress, "agents"), onto=onto)
    print(json_of(arguments.out) if arguments.json else table_of(arguments.out))
