"""Which node a g2o id means: robots' letters, files, or plain numbers."""

from __future__ import annotations

from collections.abc import Iterable

from backend.errors import BackendError
from backend.graph import NodeId

_SYMBOL_SHIFT = 56
_LETTERS = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"


class Ids:
    """The scheme of a set of files, found from all ids in it.

    - Symbols (gtsam's: a letter in the top byte) where any id is one. Robots are counted a to z, then A to Z; in ASCII
      upper case would come first. Ids without a letter belong to robot 0.
    - Else plain numbers, of any size. In one file they are all robot 0's. In a set, each file is a robot: a node
      belongs to the file that holds its vertex; where several do (each robot counts from 0), every file means its own.
    """

    def __init__(self, lines: Iterable[tuple[int, bool, tuple[int, ...]]]) -> None:
        """``lines``: of each the file's number, whether it is a vertex, and the ids."""
        everything = list(lines)
        self._symbols = any(_letter(i) >= 0 for _, _, ids in everything for i in ids)
        holders: dict[int, set[int]] = {}
        for file, is_vertex, ids in everything:
            if is_vertex:
                holders.setdefault(ids[0], set()).add(file)
        self._own_numbers = any(len(files) > 1 for files in holders.values())
        self._owner = {i: min(files) for i, files in holders.items()}

    def node(self, file: int, number: int, where: str) -> NodeId:
        """The node that ``number`` means in ``file``; ``where`` for the error message."""
        if not self._symbols:
            return NodeId(file if self._own_numbers else self._owner.get(number, file), number)
        if number >> _SYMBOL_SHIFT == 0:
            return NodeId(0, number)
        robot = _letter(number)
        if robot < 0:
            raise BackendError(f"{where}: id {number} is neither a plain number nor a symbol of a letter and an index")
        return NodeId(robot, number & ((1 << _SYMBOL_SHIFT) - 1))


def symbol(node: NodeId) -> int:
    """The gtsam symbol of a node."""
    if node.robot >= len(_LETTERS):
        raise BackendError(f"g2o symbols can name {len(_LETTERS)} robots, not robot {node.robot}")
    if node.index >> _SYMBOL_SHIFT:
        raise BackendError(f"g2o symbols cannot hold the index of node {node}")
    return (ord(_LETTERS[node.robot]) << _SYMBOL_SHIFT) | node.index


def _letter(number: int) -> int:
    """Robot that the id's top byte names, or -1."""
    top = number >> _SYMBOL_SHIFT
    return _LETTERS.find(chr(top)) if 0 < top < 128 else -1
