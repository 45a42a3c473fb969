"""Descriptors under test: ours, the baselines, and any ONNX file of the user's; what each sends, and how it
compares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam.descriptors.codebooks import Codebooks, codebooks_path
from maslam.descriptors.codes import PRODUCT_CODES, Coder
from maslam.descriptors.inference import NetVlad, to_working_size
from maslam.descriptors.scene import Scene
from maslam.frontend.vocabulary.vocabulary import BagOfWords, Vocabulary, WordIndex

from .sift_vlad import SiftVlad

Vectors = NDArray[np.float32]
_THUMBNAIL = (16, 12)
_ORB_PIXELS, _ORB_FEATURES = 76_800, 1000  # chosen on rendered held-out worlds
_RANDOM_IMAGES = 1000
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
    ``colour``: BGR images give it more than grey ones."""

    name: str
    describe: Callable[[NDArray[np.uint8]], Any]
    codes: tuple[Code, ...]
    colour: bool = False


def netvlad_methods(nets: Sequence[NetVlad]) -> list[Method]:
    """Shipped and users' models, named by their cards (``netvlad:...``) or files (``onnx:...``); of equal names by
    their weights, too."""
    names = [f"{'netvlad' if net.path.with_suffix('.json').is_file() else 'onnx'}:{net.name}" for net in nets]
    weights = [f"@{net.sha256[:6]}" if names.count(name) > 1 else "" for name, net in zip(names, nets, strict=True)]
    return [netvlad_method(net, name + more) for net, name, more in zip(nets, names, weights, strict=True)]


def netvlad_method(model: str | Path | NetVlad = "default", name: str = "") -> Method:
    """A shipped or a user's ONNX model, with each code there is for it."""
    net = model if isinstance(model, NetVlad) else NetVlad.load(model)
    coders = [Coder.of(net, code) for code in codes_of(net)]
    codes = [coded(coder) for coder in coders]
    codes += [asked_in_code(coder) for coder in coders if coder.code in PRODUCT_CODES]
    return Method(name or f"netvlad:{net.name}", lambda image: net.describe([image])[0], tuple(codes), net.colour)


def codes_of(net: NetVlad) -> list[str]:
    """The codes there are for a model's vectors: shorter prefixes where there is more to shorten, product codes where
    their codebooks lie beside the model."""
    prefixes = [f"x{dim}" for dim in (256, 128) if dim < net.dim]
    names = [f"{kind}{prefix}" for kind in ("float32", "int8") for prefix in ("", *prefixes)] + ["int4"]
    books = codebooks_path(net.path)
    known = Codebooks.load(books).books if books.is_file() else {}
    return names + [code for code in PRODUCT_CODES if code in known]


def thumbnail_method() -> Method:
    """The standardised 16x12 thumbnail: what any descriptor must beat."""

    def describe(image: NDArray[np.uint8]) -> Vectors:
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        small = cv2.resize(grey, _THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.float32).ravel()
        centred = small - small.mean()
        return np.asarray(centred / max(float(np.linalg.norm(centred)), 1e-6), dtype=np.float32)

    return Method("thumbnail", describe, (coded(Coder.make("float32", _THUMBNAIL[0] * _THUMBNAIL[1], "", None)),))


def sift_method(model: SiftVlad) -> Method:
    """Dense RootSIFT-VLAD: raw, and whitened to as many numbers and bytes as our codes have."""
    raw, dim = len(model.vlad_mean), len(model.vlad_axes)
    coders = {code: Coder.make(code, dim, "", None) for code in ("float32", "int8", f"int8x{dim // 2}", "int4")}
    codes = [coded(coder, f"pca{dim}-{code}", model.whiten) for code, coder in coders.items()]
    return Method("rootsift-vlad", model.describe, (coded(Coder.make("float32", raw, "", None)), *codes))


def words_method(vocabulary: Vocabulary) -> Method:
    """Bag of words of ORB key-points, ranked by DBoW2's L1 score of tf-idf vectors; distance: one minus the score."""
    from ..vocabulary import describe_orb

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
    """The learned half of our architecture before any training (centres and principal axes from a thousand of
    ``images``, spread out): what training must add to. Its other half, gradient histograms, is the RootSIFT-VLAD
    baseline's matter. Needs torch."""
    import torch

    from maslam.descriptors.config import NetVladConfig
    from maslam.descriptors.training.initialisation import fit_projection, initialise
    from maslam.descriptors.training.network import build_network

    config, pixels = NetVladConfig(gradient_levels=()), NetVlad.load().card.input_pixels
    network = build_network(config, seed)
    height = round((pixels * 3 / 4) ** 0.5)
    shape = (round(pixels / height), height)
    chosen = images[:: max(1, len(images) // _RANDOM_IMAGES)]
    stack = np.stack([cv2.resize(image, shape, interpolation=cv2.INTER_AREA) for image in chosen])
    initialise(network, stack, np.random.default_rng(seed))
    fit_projection(network, stack)

    def describe(image: NDArray[np.uint8]) -> Vectors:
        with torch.no_grad():
            return np.asarray(network(torch.from_numpy(to_working_size(image, pixels))[None, None])[0].numpy())

    codes = tuple(coded(Coder.make(code, config.dim, "", None)) for code in ("float32", "int8"))
    return Method("random-weights", describe, codes)


def coded(coder: Coder, name: str = "", prepare: Callable[[Vectors], Vectors] | None = None) -> Code:
    """Vectors as ``coder`` sends them: references decoded, compared with whole queries. ``prepare`` is done to the rows
    of both before. Product codes are sharpened by what the asking side knows of its own images, as a receiver does."""

    def distances(queries: Sequence[Any], references: Sequence[Any]) -> NDArray[np.float32]:
        asked, known = (np.stack(side) for side in (queries, references))
        if prepare is not None:
            asked, known = prepare(asked), prepare(known)
        decoded = coder.decode(coder.encode(known))
        if coder.code in PRODUCT_CODES:
            decoded = Scene.of(coder, asked).sharpened(decoded)
        return euclidean(coder.cut(asked), decoded)

    return Code(name or coder.code, lambda _: coder.bytes, distances)


def asked_in_code(coder: Coder) -> Code:
    """The other way round: a query comes coded, and the one who is asked compares it with its own whole vectors. Of
    codes that are fine enough it makes no difference."""

    def distances(queries: Sequence[Any], references: Sequence[Any]) -> NDArray[np.float32]:
        asked, known = (np.stack(side) for side in (queries, references))
        return euclidean(coder.decode(coder.encode(asked)), coder.cut(known))

    return Code(f"{coder.code}-query", lambda _: coder.bytes, distances)


def euclidean(queries: Vectors, references: Vectors) -> NDArray[np.float32]:
    """Distances ``(Q, R)`` between rows."""
    squares = (queries**2).sum(axis=1)[:, None] + (references**2).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squares - 2.0 * (queries @ references.T), 0.0)), dtype=np.float32)
