"""``maslam netvlad``: train, export, calibrate, evaluate and use the place descriptor (docs/netvlad.md)."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

from tools.errors import ToolError

if TYPE_CHECKING:
    from tools.netvlad_eval import Method

CACHE = Path("worlds_cache")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the actions."""
    from descriptors.config import TrainingConfig
    from tools.netvlad_train import MaterialConfig
    from tools.netvlad_use import add_calibration_arguments, add_use_actions
    from tools.options import add_model_options

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
    _world_arguments(train)
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
    _world_arguments(calibrate)
    _held_out_arguments(calibrate)
    add_calibration_arguments(calibrate)
    evaluate = actions.add_parser("eval", help="recall and precision on real sets and held-out rendered worlds")
    evaluate.add_argument(
        "--model", metavar="NAME|FILE", action="append", help="default: the shipped one; may be repeated"
    )
    evaluate.add_argument("--data", type=Path, metavar="DIR", help="folder of the real sets (default: $MASLAM_DATA)")
    evaluate.add_argument("--random", action="store_true", help="also the untrained network (needs maslam[train])")
    evaluate.add_argument("--json", action="store_true", help="records instead of a table")
    _world_arguments(evaluate)
    _held_out_arguments(evaluate)
    add_use_actions(actions)


def main(arguments: argparse.Namespace) -> None:
    """Do the action asked for."""
    from tools.netvlad_use import run_describe, run_info

    run = {
        "train": _train, "export": _export, "calibrate": _calibrate, "eval": _evaluate, "info": run_info,
        "describe": run_describe,
    }  # fmt: skip
    run[arguments.action](arguments)


def _train(arguments: argparse.Namespace) -> None:
    from descriptors.config import TrainingConfig
    from tools.netvlad_train import MaterialConfig, TrainJob, train
    from tools.options import build, read_yaml
    from tools.progress import progress_on

    content = read_yaml(arguments.config) if arguments.config else {}
    config = build(TrainingConfig(), arguments, content.get("training"), arguments.config, "training")
    material = build(MaterialConfig(), arguments, content.get("material"), arguments.config, "material")
    job = TrainJob(arguments.out, arguments.photos, arguments.cache, arguments.start, arguments.workers)
    with _needing_torch(), progress_on(quiet=arguments.quiet) as progress:
        print(train(job, config, material, progress))


def _export(arguments: argparse.Namespace) -> None:
    from tools.netvlad_export import ExportJob, export_model
    from tools.progress import progress_on

    job = ExportJob(
        arguments.checkpoint, arguments.out, arguments.name, arguments.dim, arguments.pixels, arguments.note
    )
    with _needing_torch(), progress_on(quiet=arguments.quiet) as progress:
        print(export_model(job, progress))


def _calibrate(arguments: argparse.Namespace) -> None:
    from tools.netvlad_use import run_calibration

    run_calibration(arguments, _kinds(arguments))


def _evaluate(arguments: argparse.Namespace) -> None:
    from tools.netvlad_calibrate import CalibrationSettings, held_out_benchmarks
    from tools.netvlad_eval import (
        as_records,
        evaluate,
        netvlad_method,
        public_benchmarks,
        random_method,
        table,
        thumbnail_method,
    )
    from tools.progress import progress_on

    root = arguments.data or Path(os.environ.get("MASLAM_DATA", "../shared/data"))
    settings = CalibrationSettings(arguments.worlds, arguments.places, absent=0.0, kinds=_kinds(arguments))
    with progress_on(quiet=arguments.quiet) as progress:
        worlds = held_out_benchmarks(settings, arguments.cache, arguments.workers, progress) if settings.worlds else []
        benchmarks = public_benchmarks(root) + worlds
        if not benchmarks:
            raise ToolError(f"{root}: holds no place-recognition set, and no rendered world is asked for (--worlds)")
        methods: list[Method] = [netvlad_method(model) for model in arguments.model or ["default"]]
        methods.append(thumbnail_method())
        if arguments.random:
            with _needing_torch():
                methods.append(random_method([image for one in benchmarks for image in one.references]))
        task = progress.start("evaluating", len(methods) * len(benchmarks))
        scores = []
        for one in benchmarks:
            for method in methods:
                scores += evaluate(method, one)
                progress.advance(task, len({(score.dataset, score.method) for score in scores}))
    print(json.dumps(as_records(scores), indent=1) if arguments.json else table(scores))


def _world_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--cache", type=Path, default=CACHE, metavar="DIR", help="rendered places, kept (default: %(default)s)"
    )
    parser.add_argument(
        "--workers", type=int, default=0, metavar="N", help="processes that render (default: one a core)"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")


def _held_out_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--worlds", type=int, default=2, metavar="N", help="held-out worlds of each kind (default: %(default)s)"
    )
    parser.add_argument(
        "--places", type=int, default=120, metavar="N", help="places of each world (default: %(default)s)"
    )
    parser.add_argument(
        "--kinds", default="indoor,town", metavar="KINDS", help="kinds of worlds (default: %(default)s)"
    )


def _kinds(arguments: argparse.Namespace) -> tuple[str, ...]:
    from tools.errors import UsageError
    from tools.netvlad_train import KINDS

    kinds = tuple(sorted(set(arguments.kinds.split(","))))
    if not set(kinds) <= set(KINDS):
        raise UsageError(f"--kinds {arguments.kinds}: {', '.join(KINDS)} are known")
    return kinds


class _needing_torch:
    """Says which extra is missing where torch, kornia or onnx cannot be imported."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ModuleNotFoundError) and (error.name or "").split(".")[0] in {"torch", "kornia", "onnx"}:
            raise ToolError(f"{error.name} is not installed: pip install 'maslam[train]'") from error
