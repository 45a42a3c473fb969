"""The images behind accepted matches, found again in the data the run was made from."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ReadingConfig, open_dataset
from maslam.frontend.errors import FrontendError
from maslam.frontend.recording_config import RecordingConfig

from .run_data import RunData

if TYPE_CHECKING:
    from maslam.frontend.datasets import ImageSequence

SHOWN = 6
WIDTH_PX = 460
JPEG_QUALITY = 82


@dataclass(frozen=True)
class MatchImages:
    """One accepted match: the query's and the match's image as data URLs, and the row of ``matches.csv``."""

    query: str
    match: str
    row: dict[str, str]


def sample_images(run: RunData) -> tuple[list[MatchImages], str]:
    """Up to ``SHOWN`` accepted matches with their images; where there are none, the reason in a sentence."""
    own = {k for k, entry in enumerate(run.manifest.agents) if entry.source is None}
    here = [row for row in run.accepted if own.issuperset((int(row["query_agent"]), int(row["match_agent"])))]
    rows = choose(here)
    if run.accepted and not rows:
        return [], "All accepted matches are with agents of the earlier run, whose images lie elsewhere."
    if not rows:
        return [], "No match was accepted, so there are no images to show."
    try:
        recording = RecordingConfig(**run.manifest.settings.get("recording", {}))
        reading = ReadingConfig.model_validate(run.manifest.settings.get("images") or {})
        source = Path(run.manifest.source)
        dataset = open_dataset(source, RigKind.MONO, strict=False, recording=recording, reading=reading)
        sequences = {sequence.name: sequence for sequence in dataset.sequences}
        return [_images(run, row, sequences) for row in rows], ""
    except (FrontendError, KeyError, ValueError) as error:
        return [], f"The images are not where they were when this was made ({error}), so none can be shown."


def choose(accepted: list[dict[str, str]]) -> list[dict[str, str]]:
    """Matches of as many different pairs of agents as possible, in each pair those with the most inliers first."""
    pairs: dict[tuple[int, int], list[dict[str, str]]] = {}
    for row in accepted:
        ends = sorted((int(row["query_agent"]), int(row["match_agent"])))
        pairs.setdefault((ends[0], ends[1]), []).append(row)
    # Own loops (both ends one agent) come after matches between agents.
    order = sorted(pairs, key=lambda pair: (pair[0] == pair[1], pair))
    ranked = [sorted(pairs[pair], key=lambda row: (-int(row["inliers"] or 0), row["time_s"])) for pair in order]
    turns = [row for turn in zip_longest(*ranked) for row in turn if row is not None]
    return turns[:SHOWN]


def _images(run: RunData, row: dict[str, str], sequences: dict[str, ImageSequence]) -> MatchImages:
    query, match = (
        _data_url(sequences[run.manifest.agents[int(row[f"{end}_agent"])].sequence], int(row[f"{end}_stamp_ns"]))
        for end in ("query", "match")
    )
    return MatchImages(query, match, row)


def _data_url(sequence: ImageSequence, stamp_ns: int) -> str:
    import cv2

    image = sequence.read(int(np.argmin(np.abs(sequence.stamps_ns - stamp_ns)))).image
    height = round(image.shape[0] * WIDTH_PX / image.shape[1])
    small = cv2.resize(image, (WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    _, encoded = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return f"data:image/jpeg;base64,{base64.b64encode(encoded.tobytes()).decode('ascii')}"
