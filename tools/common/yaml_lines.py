"""Line numbers of settings in a YAML file, for messages about them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from maslam._bounded import Unreadable, read_text


def place_of(path: Path, keys: Sequence[str]) -> str:
    """``"file:line"`` of the key that the nested ``keys`` lead to; ``"file"`` where there is none."""
    line = _line_of(path, keys)
    return str(path) if line is None else f"{path}:{line}"


def _line_of(path: Path, keys: Sequence[str]) -> int | None:
    import yaml

    try:
        node: yaml.Node | None = yaml.compose(read_text(path), Loader=yaml.SafeLoader)
    except (OSError, yaml.YAMLError, Unreadable, RecursionError):
        return None
    line = None
    for key in keys:
        entries = node.value if isinstance(node, yaml.MappingNode) else []
        found = next(((k, v) for k, v in entries if k.value == key), None)
        if found is None:
            return None
        line, node = found[0].start_mark.line + 1, found[1]
    return line
