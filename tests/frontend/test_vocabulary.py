"""The vocabulary against trees made by hand and descents by brute force, and its two file forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.frontend.errors import FrontendError
from maslam.frontend.vocabulary.training import train_vocabulary
from maslam.frontend.vocabulary.vocabulary import BagOfWords, Vocabulary, WordIndex


def octets(*bits: int) -> NDArray[np.uint8]:
    """A descriptor with these of its 256 bits set."""
    out = np.zeros(256, np.uint8)
    out[list(bits)] = 1
    return np.packbits(out, bitorder="little")


def hand_made() -> Vocabulary:
    """Two branches; left has two leaves on level 2, right ends on level 1. Node ids in DBoW2's order."""
    nodes = [(-1, ()), (0, range(10)), (0, range(100, 110)), (1, range(5)), (1, range(5, 10))]
    parents = np.array([parent for parent, _ in nodes], np.int32)
    return Vocabulary(2, 2, parents, np.stack([octets(*bits) for _, bits in nodes]), np.array([0, 0, 0.5, 1.0, 2.0]))


def random_tree(rng: np.random.Generator, branching: int = 3, depth: int = 5, stop: float = 0.1) -> Vocabulary:
    """Depth first, some nodes ending early, children not next to each other."""
    parents, level = [-1], [0]
    while len(parents) < 200:
        parent = int(rng.integers(0, len(parents)))
        if level[parent] < depth and parents.count(parent) < branching and (parent == 0 or rng.random() > stop):
            parents.append(parent)
            level.append(level[parent] + 1)
    descriptors = rng.integers(0, 256, (len(parents), 32)).astype(np.uint8)
    return Vocabulary(branching, depth, np.array(parents, np.int32), descriptors, rng.random(len(parents)))


def brute_descent(vocabulary: Vocabulary, descriptor: NDArray[np.uint8], level: int) -> int:
    node = 0
    for _ in range(level):
        children = np.flatnonzero(vocabulary.parents == node)
        if not len(children):
            break
        distances = [int(np.unpackbits(vocabulary.descriptors[c] ^ descriptor).sum()) for c in children]
        node = int(children[int(np.argmin(distances))])
    return node


def test_a_tree_made_by_hand() -> None:
    vocabulary = hand_made()
    asked = np.stack([octets(0, 1, 2), octets(6, 7, 8, 9), octets(101, 102), octets()])
    # The last is as far from both branches: DBoW2 takes the first.
    assert vocabulary.leaves(asked).tolist() == [3, 4, 2, 3]
    assert vocabulary.words(asked).tolist() == [[3, 3], [4, 4], [2, 2], [3, 3]]
    assert vocabulary.levels.tolist() == [0, 1, 1, 2, 2] and vocabulary.is_leaf.tolist() == [
        False,
        False,
        True,
        True,
        True,
    ]
    bag = vocabulary.bag(asked)
    assert bag.words.tolist() == [2, 3, 4]
    np.testing.assert_allclose(bag.values, np.array([0.5, 2 * 1.0, 2.0]) / 4.5)


def test_descent_equals_brute_force() -> None:
    rng = np.random.default_rng(3)
    vocabulary = random_tree(rng)
    asked = rng.integers(0, 256, (300, 32)).astype(np.uint8)
    words, leaves = vocabulary.words(asked), vocabulary.leaves(asked)
    assert words.dtype == np.int32 and words.shape == (300, 2)
    for descriptor, (three, four), leaf in zip(asked, words, leaves, strict=True):
        assert (three, four) == (brute_descent(vocabulary, descriptor, 3), brute_descent(vocabulary, descriptor, 4))
        assert leaf == brute_descent(vocabulary, descriptor, 9) and vocabulary.is_leaf[leaf]


def test_no_descriptors_and_descriptors_of_another_kind() -> None:
    vocabulary = hand_made()
    assert vocabulary.words(np.zeros((0, 32), np.uint8)).shape == (0, 2)
    assert len(vocabulary.bag(np.zeros((0, 32), np.uint8)).words) == 0
    with pytest.raises(ValueError, match=r"\(N, 32\)"):
        vocabulary.words(np.zeros((4, 64), np.uint8))


@pytest.mark.parametrize("name", ["v.npz", "v.txt"])
def test_file_round_trips(tmp_path: Path, name: str) -> None:
    vocabulary = random_tree(np.random.default_rng(1))
    vocabulary.weights[:] = vocabulary.weights.astype(np.float32)
    for path in (tmp_path / name, tmp_path / f"again_{name}"):
        vocabulary.save(path)
    assert (tmp_path / name).read_bytes() == (tmp_path / f"again_{name}").read_bytes()
    read = Vocabulary.load(tmp_path / name)
    assert (read.branching, read.depth) == (vocabulary.branching, vocabulary.depth)
    for field in ("parents", "weights", "is_leaf"):
        np.testing.assert_array_equal(getattr(read, field), getattr(vocabulary, field))
    np.testing.assert_array_equal(read.descriptors[1:], vocabulary.descriptors[1:])


def line(parent: int, leaf: int, bits: tuple[int, ...], weight: str) -> str:
    return f"{parent} {leaf} " + " ".join(map(str, octets(*bits))) + f" {weight}"


ORBVOC = "\n".join([
    "2 2  0 0", line(0, 0, tuple(range(10)), "0"), line(0, 1, tuple(range(100, 110)), "0.5"),
    line(1, 1, tuple(range(5)), "1"), line(1, 1, tuple(range(5, 10)), "2.0e0 "), "",
])  # fmt: skip
"""ORB-SLAM2's layout, written here: header, then a line a node; two blanks in the header, one after a descriptor or
a line."""


def test_the_text_form_of_orb_slam2(tmp_path: Path) -> None:
    path = tmp_path / "ORBvoc.txt"
    path.write_text(ORBVOC)
    vocabulary, expected = Vocabulary.load(path), hand_made()
    for field in ("parents", "descriptors", "weights", "is_leaf"):
        np.testing.assert_array_equal(getattr(vocabulary, field), getattr(expected, field))
    path.write_text(ORBVOC.replace("\n", "\r\n") + "\r\n\r\n")
    np.testing.assert_array_equal(Vocabulary.load(path).parents, expected.parents)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("2 2  0 0", "2 2 0", r"v.txt:1: the first line must be four integers"),
        ("2 2  0 0", "1 2  0 0", r"v.txt:1: branching 1 \(2 to 20\)"),
        ("2 2  0 0", "2 2  5 0", r"v.txt:1: scoring 5"),
        ("\n1 1 ", "\n9 1 ", r"v.txt:4: no node of a tree"),
        ("\n0 1 ", "\n0 1 300 ", r"v.txt:3: a node has 35 numbers .* found 36"),
        (" 0.5\n", " half\n", r"v.txt:3: not a number"),
        (" 0.5\n", " nan\n", r"v.txt:3: no node"),
        ("\n0 0 255 3 ", "\n0 0 255 3x ", r"v.txt:2: not a number"),
        ("\n0 0 255 3 ", "\n0 0 256 3 ", r"v.txt:2: no node .* bytes 0 to 255"),
        ("\n0 0 255", "\n0 1 255", r"v.txt:2: no node .* no children of a leaf"),
    ],
)
def test_broken_text_files(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in ORBVOC
    (tmp_path / "v.txt").write_text(ORBVOC.replace(old, new, 1))
    with pytest.raises(FrontendError, match=message):
        Vocabulary.load(tmp_path / "v.txt")


def test_broken_binary_files(tmp_path: Path) -> None:
    path = tmp_path / "v.npz"
    path.write_bytes(b"not a zip")
    with pytest.raises(FrontendError, match=r"v.npz: not a vocabulary"):
        Vocabulary.load(path)
    with pytest.raises(FrontendError, match=r"none.npz: cannot be read as a vocabulary"):
        Vocabulary.load(tmp_path / "none.npz")
    hand_made().save(path)
    data = dict(np.load(path))
    np.savez(path, **{**data, "format": np.array(2)})
    with pytest.raises(FrontendError, match="of format 2"):
        Vocabulary.load(path)


def clustered(
    rng: np.random.Generator, centres: int, each: int, flips: int
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Descriptors around random centres, ``flips`` of 256 bits away each, and which centre each belongs to."""
    middle = rng.integers(0, 2, (centres, 256)).astype(np.uint8)
    rows = np.repeat(middle, each, axis=0)
    for row in rows:
        row[rng.choice(256, flips, replace=False)] ^= 1
    return np.packbits(rows, axis=1), np.repeat(np.arange(centres), each)


def test_training_finds_the_clusters_that_there_are() -> None:
    rng = np.random.default_rng(5)
    descriptors, centre = clustered(rng, centres=4, each=60, flips=20)
    vocabulary = train_vocabulary([descriptors[i::3] for i in range(3)], np.random.default_rng(0), branching=4, depth=2)
    ancestors = vocabulary.leaves(descriptors)
    ancestors = np.where(vocabulary.parents[ancestors] > 0, vocabulary.parents[ancestors], ancestors)
    assert [len(set(ancestors[centre == c])) for c in range(4)] == [1, 1, 1, 1] and len(set(ancestors)) == 4


def test_training_numbers_nodes_as_dbow2_and_weighs_by_rarity() -> None:
    rng = np.random.default_rng(6)
    images = [rng.integers(0, 256, (150, 32)).astype(np.uint8) for _ in range(4)]
    vocabulary = train_vocabulary(images, np.random.default_rng(0), branching=3, depth=3)
    levels = vocabulary.levels
    for node in range(1, len(vocabulary)):
        children = np.flatnonzero(vocabulary.parents == node)
        # Children in one block, and a subtree ends before the next sibling's begins.
        assert len(children) == 0 or np.array_equal(children, np.arange(children[0], children[0] + len(children)))
    inner = np.flatnonzero(levels == 1)
    firsts = [int(np.flatnonzero(vocabulary.parents == node)[0]) for node in inner]
    assert firsts == sorted(firsts) and firsts[0] == len(inner) + 1
    leaves = [set(vocabulary.leaves(image).tolist()) for image in images]
    for leaf in np.flatnonzero(vocabulary.is_leaf):
        seen = sum(leaf in words for words in leaves)
        assert seen > 0 and vocabulary.weights[leaf] == pytest.approx(np.log(4 / seen))


def test_training_is_repeatable_and_takes_few_different_descriptors() -> None:
    rng = np.random.default_rng(6)
    images = [rng.integers(0, 256, (100, 32)).astype(np.uint8) for _ in range(3)]
    first, second = (train_vocabulary(images, np.random.default_rng(9), 4, 3) for _ in range(2))
    np.testing.assert_array_equal(first.descriptors, second.descriptors)
    np.testing.assert_array_equal(first.parents, second.parents)
    same = train_vocabulary([np.repeat(images[0][:2], 20, axis=0)], np.random.default_rng(0), 3, 2)
    assert sorted(map(bytes, same.descriptors[same.is_leaf])) == sorted(map(bytes, images[0][:2]))
    with pytest.raises(ValueError, match="too few"):
        train_vocabulary([images[0][:2]], np.random.default_rng(0), 3, 2)


def test_bags_score_as_dbow2() -> None:
    a = BagOfWords(np.array([1, 4, 9], np.int32), np.array([0.5, 0.25, 0.25]))
    b = BagOfWords(np.array([4, 9, 12], np.int32), np.array([0.5, 0.25, 0.25]))
    # 1 - |a - b|_1 / 2, written out: |0.5| + |-0.25| + |0| + |-0.25| = 1.
    index = WordIndex()
    assert [index.add(bag) for bag in (b, a, BagOfWords(np.array([7], np.int32), np.array([1.0])))] == [0, 1, 2]
    assert index.most_similar(a, 5) == [(1, pytest.approx(1.0)), (0, pytest.approx(0.5))]
    assert index.most_similar(a, 1) == [(1, pytest.approx(1.0))]


@pytest.mark.parametrize(
    ("parents", "descriptors"),
    [([-1], 1), ([-1, 0, 3, 0], 4), ([0, 0], 2), ([-1, -1], 2), ([-1, 0], 3)],
)
def test_what_is_no_tree_cannot_be_made(parents: list[int], descriptors: int) -> None:
    with pytest.raises(ValueError, match=r"tree|parent"):
        Vocabulary(2, 2, np.array(parents, np.int32), np.zeros((descriptors, 32), np.uint8), np.zeros(len(parents)))


def test_the_shipped_vocabulary_fits_its_purpose() -> None:
    vocabulary = Vocabulary.load()
    counts = np.bincount(vocabulary.levels)
    assert (vocabulary.branching, vocabulary.depth) == (10, 4) and counts[3] > 900 and counts[4] > 9000
    assert len(vocabulary) < 2**16, "node ids are sent in two bytes"
    rng = np.random.default_rng(0)
    words = vocabulary.words(rng.integers(0, 256, (5000, 32)).astype(np.uint8))
    levels = vocabulary.levels
    assert set(levels[words[:, 0]]) == {3} and (levels[words[:, 1]] == 4).mean() > 0.99
    assert (vocabulary.parents[words[:, 1]] == words[:, 0])[levels[words[:, 1]] == 4].all()


def orbvoc_like(rng: np.random.Generator, full: int) -> tuple[list[str], list[int]]:
    """Lines of a file laid out as ORBvoc.txt, k = 10 and L = 6: children together, then the subtree of each; complete
    down to level ``full``, below that one child in ten has children. And the level of each node from 1 on."""
    lines, levels = ["10 6  0 0"], []

    def grow(parent: int, level: int) -> None:
        first = len(lines)
        deeper = [level < 6 and (level < full or child == 3) for child in range(10)]
        for child in range(10):
            octets = " ".join(map(str, rng.integers(0, 256, 32)))
            lines.append(f"{parent} {int(not deeper[child])} {octets}  {0 if deeper[child] else rng.uniform(1, 9):.6g}")
            levels.append(level)
        for child in range(10):
            if deeper[child]:
                grow(first + child, level + 1)

    grow(0, 1)
    return lines, levels


def test_a_file_laid_out_as_orbvoc_gives_levels_3_and_4_of_six(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    lines, levels = orbvoc_like(rng, full=4)
    (tmp_path / "ORBvoc.txt").write_text("\n".join(lines) + "\n")
    vocabulary = Vocabulary.load(tmp_path / "ORBvoc.txt")
    assert (vocabulary.branching, vocabulary.depth, len(vocabulary)) == (10, 6, len(lines))
    np.testing.assert_array_equal(vocabulary.levels, [0, *levels])
    asked = rng.integers(0, 256, (60, 32)).astype(np.uint8)
    words, leaves = vocabulary.words(asked), vocabulary.leaves(asked)
    assert set(vocabulary.levels[words[:, 0]]) == {3} and set(vocabulary.levels[words[:, 1]]) == {4}
    for descriptor, (three, four), leaf in zip(asked, words, leaves, strict=True):
        assert (three, four) == (brute_descent(vocabulary, descriptor, 3), brute_descent(vocabulary, descriptor, 4))
        assert leaf == brute_descent(vocabulary, descriptor, 6)
    assert max(levels) == 6 and (vocabulary.levels[leaves] > 4).any()
    vocabulary.save(tmp_path / "again.txt")
    again = Vocabulary.load(tmp_path / "again.txt")
    np.testing.assert_array_equal(again.parents, vocabulary.parents)
    np.testing.assert_array_equal(again.weights, vocabulary.weights)
