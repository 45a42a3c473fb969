"""Small images show their points less exactly: what counts as the same bearing is a matter of pixels, too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from factory import town

from maslam.mas.manifest import Manifest
from maslam.mas.policies.presets import preset
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import run


def blurred(sequence: AgentSequence, metres: float, seed: int) -> AgentSequence:
    """Map points off by so much, as those of small images are."""
    rng = np.random.default_rng(seed)
    tracks = [replace(t, points=t.points + rng.normal(0.0, metres, t.points.shape)) for t in sequence.tracks]
    return replace(sequence, tracks=tuple(tracks))


def seen_by(manifest: Manifest, fx: float) -> Manifest:
    agents = [
        a.model_copy(update={"camera": a.camera.model_copy(update={"fx": fx, "fy": fx})}) for a in manifest.agents
    ]
    return manifest.model_copy(update={"agents": tuple(agents)})


def test_bearings_are_compared_in_pixels_of_a_small_image(tmp_path: Path) -> None:
    """Points are off by about a degree: three pixels of one camera, thirteen of the other."""
    manifest, sequences = town(2, 30, spacing_m=10.0, drifting=0.0)
    rough = [blurred(sequence, 0.16, agent) for agent, sequence in enumerate(sequences)]
    small = run(seen_by(manifest, 170.0), rough, preset("maslam"), tmp_path / "small")
    large = run(seen_by(manifest, 720.0), rough, preset("maslam"), tmp_path / "large")
    assert large.matches.accepted == 0
    assert small.groups == [[0, 1]] and small.matches.accepted >= 2 and small.matches.false_accepted == 0
