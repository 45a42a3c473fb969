"""``maslam netvlad``: train, export, calibrate, evaluate and use the place descriptor (docs/appendix/netvlad.md)."""

from __future__ import annotations

import argparse
from pathlib import Path

from . import codes_command, evaluate_command
from .options import add_held_out_options, add_world_options, kinds_of, needing_torch


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the actions."""
    from maslam.descriptors.config import TrainingConfig

    from ..common.options import add_model_options
    from .train import MaterialConfig
    from .use_commands import add_calibration_arguments, add_use_actions

    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    train = actions.add_parser("train", help="train on photographs and rendered worlds (needs maslam[train])")
    train.add_argument(
        "out", metavar="OUT", type=Path, help="folder for checkpoint.pt and log.jsonl; goes on if unfinished"
    )
    train.add_argument(
        "--photos", type=Path, metavar="DIR", help="folder of photographs (default: rendered worlds alone)"
    )
    train.add_argument("--start", type=Path, metavar="FILE", help="checkpoint whose weights to go on from")
    train.add_argument(
        "--config", type=Path, metavar="FILE", help="YAML with settings, `training: {...}, material: {...}`"
    )
    add_world_options(train)
    add_model_options(train, TrainingConfig(), "training")
    add_model_options(train, MaterialConfig(), "material")
    export = actions.add_parser("export", help="weights, ours or published, to ONNX with a card (needs maslam[train])")
    export.add_argument(
        "checkpoint", metavar="WEIGHTS", type=Path, help="our checkpoint; VGG16-NetVLAD from MatConvNet or PyTorch"
    )
    export.add_argument("out", metavar="OUT.onnx", type=Path)
    export.add_argument("--name", default="", help="of the model, on its card (default: what the file is)")
    export.add_argument(
        "--dim", type=int, metavar="N", help="the first N numbers of a published whitening (default: all)"
    )
    export.add_argument(
        "--pixels", type=int, metavar="N", help="size that images are brought to (default: 19200; published: 307200)"
    )
    export.add_argument("--note", default="", help="how the weights were trained, for the card")
    export.add_argument("--quiet", action="store_true", help="no progress")
    calibrate = actions.add_parser("calibrate", help="measure thresholds on rendered worlds or your own sequences")
    add_world_options(calibrate)
    add_held_out_options(calibrate)
    add_calibration_arguments(calibrate)
    evaluate = actions.add_parser("eval", help="recall and precision on real sets and held-out rendered worlds")
    evaluate_command.add_arguments(evaluate)
    codes = actions.add_parser("codes", help="make a model's codebooks, and measure what vectors in few bytes cost")
    codes_command.add_arguments(codes)
    add_use_actions(actions)


def main(arguments: argparse.Namespace) -> None:
    """Do the action asked for."""
    from .use_commands import run_card, run_describe, run_info

    run = {
        "train": _train,
        "export": _export,
        "calibrate": _calibrate,
        "eval": evaluate_command.main,
        "info": run_info,
        "card": run_card,
        "describe": run_describe,
        "codes": codes_command.main,
    }
    run[arguments.action](arguments)


def _train(arguments: argparse.Namespace) -> None:
    from maslam.descriptors.config import TrainingConfig

    from ..common.options import build, read_settings
    from ..common.progress import progress_on
    from .train import MaterialConfig, TrainJob, train

    content = read_settings(arguments.config, ("training", "material"))
    config = build(TrainingConfig(), arguments, content.get("training"), arguments.config, "training")
    material = build(MaterialConfig(), arguments, content.get("material"), arguments.config, "material")
    job = TrainJob(arguments.out, arguments.photos, arguments.cache, arguments.start, arguments.workers)
    with needing_torch(), progress_on(quiet=arguments.quiet) as progress:
        print(train(job, config, material, progress))


def _export(arguments: argparse.Namespace) -> None:
    from ..common.progress import progress_on
    from .export import ExportJob, export_model

    job = ExportJob(
        arguments.checkpoint, arguments.out, arguments.name, arguments.dim, arguments.pixels, arguments.note
    )
    with needing_torch(), progress_on(quiet=arguments.quiet) as progress:
        print(export_model(job, progress))


def _calibrate(arguments: argparse.Namespace) -> None:
    from .use_commands import run_calibration

    run_calibration(arguments, kinds_of(arguments))
