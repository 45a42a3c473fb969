"""Odometry and place vectors in one pass: what is decoded, and what the descriptor gets to see."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest

import maslam.frontend.datasets.base as base
from maslam.descriptors.inference import NetVlad
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.datasets import open_dataset
from maslam.frontend.errors import FrontendError
from maslam.frontend.vocabulary.vocabulary import Vocabulary
from maslam.tools.pipeline.tracking import track
from tests.descriptors.conftest import tiny_model


@pytest.mark.parametrize("rig", ["mono", "stereo"])
def test_every_image_is_decoded_once(town_stereo: Path, rig: str, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded: Counter[Path] = Counter()
    read = base.read_grey

    def counting(path: Path) -> np.ndarray:
        decoded[path] += 1
        return read(path)

    monkeypatch.setattr(base, "read_grey", counting)
    model = NetVlad.load()
    looked = []
    monkeypatch.setattr(model, "look", lambda images: looked.append(1) or NetVlad.look(model, images))
    sequence = open_dataset(town_stereo, RigKind(rig)).sequences[0]
    result = track(sequence, OdometryConfig(), Vocabulary.load(None), model, lambda _: None)
    assert sum(len(k) for k in result.keyframes) >= 3
    assert {path: decoded[path] for path in sequence.left} == dict.fromkeys(sequence.left, 1)
    assert set(decoded.values()) == {1}, "right images too, those that are needed"
    assert len(looked) <= len(result.vectors) + 2, "frames that only support odometry are not described"
    # The vectors are those of the key-frames' images.
    images = [sequence.read(int(i)).image for k in result.keyframes for i in k]
    np.testing.assert_array_equal(result.vectors, model.describe(images))
    np.testing.assert_array_equal(result.textured, model.textured(images))


def test_a_colour_network_sees_the_colours_of_the_key_frames(town_stereo: Path, tmp_path: Path) -> None:
    model = NetVlad.load(tiny_model(tmp_path / "means.onnx", channels=3, card={"input_pixels": 320 * 180}))
    sequence = open_dataset(town_stereo, RigKind("stereo")).sequences[0]
    result = track(sequence, OdometryConfig(), Vocabulary.load(None), model, lambda _: None)
    files = [sequence.left[int(i)] for k in result.keyframes for i in k]
    means = np.stack([cv2.imread(str(path)).mean(axis=(0, 1))[::-1] for path in files])
    np.testing.assert_allclose(result.vectors, means / np.linalg.norm(means, axis=1, keepdims=True), atol=1e-4)


@pytest.mark.parametrize("rig", ["mono", "stereo"])
def test_frames_of_a_track_that_is_not_kept_have_their_reason(town_stereo: Path, rig: str) -> None:
    """Each frame of the sequence is counted once: those before a start by their refusal, those with a pose in a track
    that ends too soon as such."""
    sequence = open_dataset(town_stereo, RigKind(rig)).sequences[0]
    config = OdometryConfig(min_track_keyframes=1000)
    with pytest.raises(FrontendError) as refused:
        track(sequence, config, Vocabulary.load(None), NetVlad.load(), lambda _: None)
    message = str(refused.value)
    assert message.startswith(f"no frame of {len(sequence)} could be tracked: the track is too short (")
    assert sum(int(n) for n in re.findall(r"\((\d+) x\)", message)) == len(sequence)
