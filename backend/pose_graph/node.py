"""Names of nodes and robots."""

from __future__ import annotations

from typing import NamedTuple

LETTERS = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
"""Of robots in gtsam's symbols, in order."""


class NodeId(NamedTuple):
    """Key-frame ``index`` of ``robot``; sorts by robot, then index."""

    robot: int
    index: int  # type: ignore[assignment]  # hides tuple.index, which nobody calls on a node

    def __str__(self) -> str:
        label = label_of(self.robot)
        return f"{label}{self.index}" if label else f"{self.robot}:{self.index}"


def label_of(robot: int) -> str | None:
    """Letter and label of a robot of gtsam's labelled symbols (``gA``), which count the alphabet's rounds by a
    letter."""
    rounds, letter = divmod(robot, len(LETTERS))
    label = chr(rounds) if rounds < 128 else ""
    return LETTERS[letter] + label if label.isalpha() else None


def robot_name(robot: int) -> str:
    """The robot for people: its number, or letter and label."""
    return label_of(robot) or str(robot)


def symbol_name(node: NodeId) -> str:
    """The node as gtsam shows its symbol: ``x5``, ``gA5``."""
    return str(node) if label_of(node.robot) else f"{LETTERS[node.robot % len(LETTERS)]}{node.index}"
