"""Nodes of g2o ids: robots' letters, files, or plain numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import combinations

from ..errors import BackendError
from .node import LETTERS, NodeId

SYMBOL_SHIFT = 56
# Robots beyond the letters: how often the alphabet was gone through stands in the next byte.
_ROUND_SHIFT = 48
_ROUNDS = 256


class Ids:
    """The scheme of a set of files, found from all ids in it.

    - Symbols (gtsam's: a letter in the top byte) where any id is one. Robots are counted a to z, then A to Z; in ASCII
      upper case would come first. Robot 52 is a again, with 1 in the next byte (in a labelled symbol of gtsam's, as
      Swarm-SLAM writes them, that byte is the label's letter). Ids without a letter belong to robot 0.
    - Else plain numbers, of any size. In one file they are all robot 0's. In a set, each file is a robot: a node
      belongs to the file that holds its vertex. Where two files have most vertices in common, each robot counts from 0,
      and every file means its own; where few, these are ends of edges between robots, and of the file that has most
      edges there.
    """

    def __init__(self, lines: Iterable[tuple[int, bool, tuple[int, ...]]]) -> None:
        """``lines``: of each the file's number, whether it is a vertex, and the ids."""
        everything = list(lines)
        self.symbols = any(_letter(i) >= 0 for _, _, ids in everything for i in ids)
        holders: dict[int, set[int]] = {}
        edges: Counter[tuple[int, int]] = Counter()
        for file, is_vertex, ids in everything:
            if is_vertex:
                holders.setdefault(ids[0], set()).add(file)
            else:
                edges.update((file, i) for i in ids)
        self.own_numbers = _count_from_0(holders)
        self._owner = {i: min(files, key=lambda file: (-edges[file, i], file)) for i, files in holders.items()}

    def node(self, file: int, number: int, where: str) -> NodeId:
        """The node that ``number`` means in ``file``; ``where`` for the error message."""
        if not self.symbols:
            return NodeId(file if self.own_numbers else self._owner.get(number, file), number)
        if number >> SYMBOL_SHIFT == 0:
            return NodeId(0, number)
        robot = _letter(number)
        if robot < 0:
            raise BackendError(f"{where}: id {number} is neither a plain number nor a symbol of a letter and an index")
        rounds = (number >> _ROUND_SHIFT) % _ROUNDS
        return NodeId(robot + rounds * len(LETTERS), number & ((1 << _ROUND_SHIFT) - 1))


def _count_from_0(holders: Mapping[int, set[int]]) -> bool:
    """Whether two files have more than half of the vertices of one of them in common."""
    sizes = Counter(file for files in holders.values() for file in files)
    common = Counter(pair for files in holders.values() for pair in combinations(sorted(files), 2))
    return any(2 * count > min(sizes[a], sizes[b]) for (a, b), count in common.items())


def symbol(node: NodeId) -> int:
    """The gtsam symbol of a node."""
    rounds, letter = divmod(node.robot, len(LETTERS))
    if rounds >= _ROUNDS:
        raise BackendError(f"g2o symbols can name {_ROUNDS * len(LETTERS)} robots, not robot {node.robot}")
    if node.index >> _ROUND_SHIFT:
        raise BackendError(f"g2o symbols cannot hold the index of node {node}")
    return (ord(LETTERS[letter]) << SYMBOL_SHIFT) | (rounds << _ROUND_SHIFT) | node.index


def _letter(number: int) -> int:
    """Robot that the id's top byte names, or -1."""
    top = number >> SYMBOL_SHIFT
    return LETTERS.find(chr(top)) if 0 < top < 128 else -1
