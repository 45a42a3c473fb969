"""Descriptors under test: ours, the baselines, and any ONNX file of the user's; what each sends, and how it
compares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptors.inference import NetVlad, to_working_size
from frontend.vocabulary import BagOfWords, Vocabulary, WordIndex
from tools.netvlad_sift import SiftVlad, unit_rows

Vectors = NDArray[np.float32]
_THUMBNAIL = (16, 12)
_ORB_PIXELS, _ORB_FEATURES = 76_800, 1000  # chosen on rendered held-out worlds
_WORD_BYTES = 8  # a word's number and its weight, as DBoW2 keeps them, in four bytes each


@dataclass(frozen=True)
class Code:
    """One form in which descriptions are sent. ``bytes_each(descriptions)``: what one takes, on average;
    ``distances(queries, references)``: ``(Q, R)`` float32, the references having been sent."""

    name: str
    bytes_each: Callable[[Sequence[Any]], int]
    distances: Callable[[Sequence[Any], Sequence[Any]], NDArray[np.float32]]


@dataclass(frozen=True)
class Method:
    """A descriptor: ``describe`` makes a description of one image, which each of ``codes`` sends in its own form;
    ``colour``: it is told more by BGR images than by grey ones."""

    name: str
    describe: Callable[[NDArray[np.uint8]], Any]
    codes: tuple[Code, ...]
    colour: bool = False


def netvlad_method(model: str | Path | NetVlad = "default", name: str = "") -> Method:
    """A shipped or a user's ONNX model, with each code there is for it."""
    net = model if isinstance(model, NetVlad) else NetVlad.load(model)
    codes = [vector_code("float32", net.dim)]
    if net.dim >= 256:
        codes.append(vector_code(f"float32x{net.dim // 2}", net.dim // 2))
    codes.append(int8_code("int8", net.dim))
    return Method(name or f"netvlad:{net.name}", lambda image: net.describe([image])[0], tuple(codes), net.colour)


def thumbnail_method() -> Method:
    """The standardised 16x12 thumbnail: what any descriptor must beat."""

    def describe(image: NDArray[np.uint8]) -> Vectors:
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        small = cv2.resize(grey, _THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.float32).ravel()
        centred = small - small.mean()
        return np.asarray(centred / max(float(np.linalg.norm(centred)), 1e-6), dtype=np.float32)

    return Method("thumbnail", describe, (vector_code("float32", _THUMBNAIL[0] * _THUMBNAIL[1]),))


def sift_method(model: SiftVlad) -> Method:
    """Dense RootSIFT-VLAD: raw, and whitened to as many numbers and bytes as our codes have."""
    raw, dim = len(model.vlad_mean), len(model.vlad_axes)
    codes = [vector_code("float32", raw), vector_code(f"pca{dim}", dim, model.whiten)]
    codes += [int8_code(f"pca{d}-int8", d, partial(model.whiten, dim=d)) for d in (dim, dim // 2)]
    return Method("rootsift-vlad", model.describe, tuple(codes))


def words_method(vocabulary: Vocabulary) -> Method:
    """Bag of words of ORB key-points, ranked by DBoW2's L1 score of tf-idf vectors; distance: one minus the score."""
    from tools.vocabulary import describe_orb

    def describe(image: NDArray[np.uint8]) -> BagOfWords:
        grey = to_working_size(image, max(_ORB_PIXELS, image.shape[0] * image.shape[1]))
        return vocabulary.bag(describe_orb(grey, _ORB_FEATURES))

    def size(bags: Sequence[BagOfWords]) -> int:
        return round(_WORD_BYTES * float(np.mean([len(bag.words) for bag in bags])))

    return Method("bag-of-words", describe, (Code("tf-idf", size, word_distances),))


def word_distances(queries: Sequence[BagOfWords], references: Sequence[BagOfWords]) -> NDArray[np.float32]:
    """One minus DBoW2's L1 score, ``(Q, R)``: 0 equal, 1 nothing in common."""
    index = WordIndex()
    for bag in references:
        index.add(bag)
    distances = np.ones((len(queries), len(references)), dtype=np.float32)
    for row, bag in zip(distances, queries, strict=True):
        for number, score in index.most_similar(bag, len(references)):
            row[number] = 1.0 - score
    return distances


def random_method(images: Sequence[NDArray[np.uint8]], seed: int = 0) -> Method:
    """Our architecture before any training (centres and principal axes from ``images``): what training must add to.
    Needs torch."""
    import torch

    from descriptors.config import NetVladConfig
    from descriptors.initialisation import initialise
    from descriptors.netvlad import build_network

    config, pixels = NetVladConfig(), NetVlad.load().card.input_pixels
    network = build_network(config, seed)
    height = round((pixels * 3 / 4) ** 0.5)
    shape = (round(pixels / height), height)
    stack = np.stack([cv2.resize(image, shape, interpolation=cv2.INTER_AREA) for image in images])
    initialise(network, stack, np.random.default_rng(seed))

    def describe(image: NDArray[np.uint8]) -> Vectors:
        with torch.no_grad():
            return np.asarray(network(torch.from_numpy(to_working_size(image, pixels))[None, None])[0].numpy())

    return Method("random-weights", describe, (vector_code("float32", config.dim), int8_code("int8", config.dim)))


def vector_code(name: str, dim: int, prepare: Callable[[Vectors], Vectors] | None = None) -> Code:
    """The first ``dim`` numbers of a vector as float32, made of unit length again; ``prepare`` is done to the rows
    before that."""

    def distances(queries: Sequence[Any], references: Sequence[Any]) -> NDArray[np.float32]:
        return euclidean(*(_cut(side, dim, prepare) for side in (queries, references)))

    return Code(name, lambda _: 4 * dim, distances)


def int8_code(name: str, dim: int, prepare: Callable[[Vectors], Vectors] | None = None) -> Code:
    """The first ``dim`` numbers in a byte each, in 127ths of the largest of them; only the references are rounded."""

    def distances(queries: Sequence[Any], references: Sequence[Any]) -> NDArray[np.float32]:
        sent = _cut(references, dim, prepare)
        largest = np.maximum(np.abs(sent).max(axis=1, keepdims=True), 1e-12)
        return euclidean(_cut(queries, dim, prepare), unit_rows(np.rint(127.0 * sent / largest)))

    return Code(name, lambda _: dim, distances)


def euclidean(queries: Vectors, references: Vectors) -> NDArray[np.float32]:
    """Distances ``(Q, R)`` between unit rows."""
    return np.asarray(np.sqrt(np.maximum(2.0 - 2.0 * (queries @ references.T), 0.0)), dtype=np.float32)


def _cut(rows: Sequence[Any], dim: int, prepare: Callable[[Vectors], Vectors] | None) -> Vectors:
    vectors = np.stack(rows) if prepare is None else prepare(np.stack(rows))
    return unit_rows(vectors[:, :dim])
