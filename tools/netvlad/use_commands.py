"""``maslam netvlad info``, ``card``, ``describe`` and ``calibrate``: what users of a model do with it."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from .options import add_input_options, add_revisit_options, input_form_of, revisits_of

SHIPPED = "default"


def add_use_actions(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """``info``, ``card`` and ``describe``."""
    info = actions.add_parser("info", help="what a model is, its thresholds, figures and speed on this machine")
    info.add_argument("model", metavar="MODEL", nargs="?", default=SHIPPED, help="name or ONNX file (default: shipped)")
    info.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    _running_arguments(info, threads=1)
    card = actions.add_parser("card", help="write or complete the card of an ONNX file, so that it can be used here")
    card.add_argument("model", metavar="FILE.onnx", type=Path)
    for name, text in (
        ("name", "of the model"),
        ("licence", "of its weights"),
        ("training", "the commands that made them"),
        ("data", "the images they were trained on"),
        ("source", "where they come from"),
    ):
        card.add_argument(f"--{name}", metavar="TEXT", help=text)
    card.add_argument("--figures", metavar="FILE", type=Path, help="what `maslam netvlad eval --json` printed")
    add_input_options(card)
    describe = actions.add_parser("describe", help="place vectors of whole sequences or folders of images, to a file")
    describe.add_argument(
        "source", metavar="SRC", type=Path, nargs="+", help="a data set, a folder of images, or image files"
    )
    describe.add_argument(
        "-o",
        "--out",
        metavar="FILE.npz",
        type=Path,
        required=True,
        help="of several sequences each goes to FILE_<sequence>.npz; unfinished work is taken up again",
    )
    describe.add_argument("--model", default=SHIPPED, metavar="NAME|FILE", help="default: the shipped one")
    describe.add_argument("--every", type=int, default=1, metavar="N", help="only each N-th image (default: all)")
    describe.add_argument("--quiet", action="store_true", help="no progress")
    _running_arguments(describe, threads=0)


def add_calibration_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``calibrate``, excluding the choice of rendered worlds."""
    parser.add_argument("model", metavar="NAME|MODEL.onnx")
    parser.add_argument(
        "--sequence",
        metavar="DATASET",
        type=Path,
        action="append",
        default=[],
        help="measure on your own images with ground truth instead of rendered worlds; may be repeated",
    )
    parser.add_argument(
        "--out", metavar="FILE.onnx", type=Path, help="put a copy of the model with the new card here, change nothing"
    )
    parser.add_argument(
        "--precision", type=float, default=0.99, metavar="SHARE", help="of the strict threshold (default: %(default)s)"
    )
    parser.add_argument(
        "--keep",
        type=float,
        default=0.97,
        metavar="SHARE",
        help="of the right matches that the candidate threshold keeps (default: %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="the calibration as one JSON object")
    parser.add_argument("--plot", metavar="FILE", type=Path, help="the curves behind the thresholds: .png, .svg, .pdf")
    add_revisit_options(parser)


def _running_arguments(parser: argparse.ArgumentParser, threads: int) -> None:
    text = "images at a time (default: one per core)" if threads == 0 else "that share one image (default: %(default)s)"
    parser.add_argument("--threads", type=int, default=threads, metavar="N", help=text)
    parser.add_argument(
        "--provider", default="CPU", metavar="NAME", help="where onnxruntime runs it, cuda or so (default: CPU)"
    )
    parser.add_argument(
        "--batch",
        type=int,
        default=1,
        metavar="N",
        help="images that go through the network together; more than 1 is for graphics cards (default: %(default)s)",
    )


def run_info(arguments: argparse.Namespace) -> None:
    """Print the card and the speed."""
    from maslam.descriptors.session import find_provider

    from ..common.names import check_name
    from .info import as_record, as_text, measure

    check_name("--provider", find_provider, arguments.provider)
    speed = measure(arguments.model, arguments.threads, arguments.provider, arguments.batch)
    show = as_record if arguments.json else as_text
    shown = show(arguments.model, speed)
    print(json.dumps(shown, indent=1) if arguments.json else shown)


def run_card(arguments: argparse.Namespace) -> None:
    """Write the card; the line that says where."""
    from .card import complete_card

    words = {name: getattr(arguments, name) for name in ("name", "licence", "training", "data", "source")}
    given = {name: text for name, text in words.items() if text is not None}
    print(complete_card(arguments.model, input_form_of(arguments), given, arguments.figures))


def run_describe(arguments: argparse.Namespace) -> None:
    """Write the vectors of every sequence in the source."""
    from maslam.descriptors.inference import NetVlad
    from maslam.descriptors.session import find_provider

    from ..common.errors import UsageError
    from ..common.names import check_name
    from ..common.parallel import core_count
    from ..common.progress import progress_on
    from .describe import DescribeSettings, describe_file, find_images

    if arguments.every < 1:
        raise UsageError(f"--every {arguments.every}: at least 1 is meant")
    check_name("--provider", find_provider, arguments.provider)
    settings = DescribeSettings(arguments.threads or core_count(), arguments.batch)
    model = NetVlad.load(arguments.model, provider=arguments.provider, batch=arguments.batch)
    with progress_on(quiet=arguments.quiet) as progress:
        found = find_images(arguments.source, arguments.every, model.colour, progress.say)
        for images in found:
            stem = arguments.out.name.removesuffix(".npz") + (f"_{images.name}" if len(found) > 1 else "")
            out = arguments.out.with_name(f"{stem}.npz")
            print(describe_file(images, model, out, settings, progress))


def run_calibration(arguments: argparse.Namespace, kinds: tuple[str, ...]) -> None:
    """Measure, write the card, say what came out."""
    from maslam.descriptors.card import read_card

    from ..common.progress import progress_on
    from .calibrate import (
        CalibrationSettings,
        calibrate_model,
        own_benchmarks,
        summary_lines,
        target,
        world_benchmarks,
    )

    out = target(arguments.model, arguments.out)
    _, card = read_card(arguments.model)  # what is wrong with the model is reported before worlds are rendered
    settings = CalibrationSettings(
        arguments.worlds,
        arguments.places,
        precision=arguments.precision,
        candidate_share=arguments.keep,
        kinds=kinds,
    )
    with progress_on(quiet=arguments.quiet) as progress:
        if arguments.sequence:
            benchmarks, data = own_benchmarks(arguments.sequence, revisits_of(arguments), card.colour, progress)
        else:
            benchmarks, data = world_benchmarks(settings, arguments.cache, arguments.workers, progress)
        path, card = calibrate_model(arguments.model, benchmarks, data, settings, progress, out)
    assert card.calibration is not None
    if arguments.plot is not None:
        from .training_figures import calibration_picture

        calibration_picture(card.calibration, card.name, arguments.plot)
    if arguments.json:
        print(card.calibration.model_dump_json(indent=1))
    else:
        print("\n".join(summary_lines(path, card.calibration, settings.precision)))
