"""YAML, JSON and XML as calibration tools and people write them: OpenCV's dialect, messages as ROS echoes them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import yaml

from maslam._bounded import Unreadable, open_npz

from ...errors import FrontendError
from ...files.text_tables import read_text
from .fields import Fields

_MAX_YAML, _MAX_JSON = 1_000_000, 50_000_000  # characters: transforms.json names every image
_MAX_REFERENCES = 20  # to other parts of the file: some of them, nested, would fill the memory
_MOST_NUMBERS = 64  # of an array that may be a camera's
_TAB = re.compile(r"(?<=\S)[ \t]*\t[ \t]*")  # between words, where OpenCV takes it for a blank
_BLANK_MISSING = re.compile(r"\s*(?:- +)?[A-Za-z_][\w.]*:(?![\s/])\S")


def load_fields(path: Path) -> Fields:
    """The keys of a YAML, JSON or OpenCV XML file, or of an archive of arrays (``.npz``); of several documents in one
    file, the first.

    Values stay text until they are asked for, so no number is taken for an octal one or a time. Raises
    :class:`FrontendError` for anything else, and for a key that is there twice with two values.
    """
    if path.suffix.lower() == ".npz":
        return Fields(_arrays(path), path)
    text = read_text(path)
    if len(text) > (_MAX_JSON if path.suffix.lower() == ".json" else _MAX_YAML):
        raise FrontendError(f"{path}: {len(text)} characters: too large for a calibration")
    try:
        start = text.lstrip()[:5]
        data = _xml(text) if start == "<?xml" else _json(text) if start.startswith("{") else None
        data = _yaml(text) if data is None else data
    except RecursionError:
        raise FrontendError(f"{path}: nested too deeply for a calibration") from None
    except yaml.YAMLError as error:
        raise FrontendError(f"{path}: {_cure(text) or 'not YAML: ' + ' '.join(str(error).split())}") from error
    except ValueError as error:
        raise FrontendError(f"{path}: {error}") from error
    if not isinstance(data, dict) or any(":" in str(key) and data[key] is None for key in data):
        raise FrontendError(f"{path}: {_cure(text) or 'not a calibration: keys and values expected'}")
    return Fields(data, path)


def _arrays(path: Path) -> dict[str, Any]:
    """The small arrays of numbers in an archive, as lists: pictures and views of a board lie there, too."""
    try:
        with open_npz(path) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except Unreadable as error:
        raise FrontendError(f"{path}: {error}") from error
    except OSError as error:
        raise FrontendError(f"{path}: cannot be read: {error.strerror}") from error
    small = {name: array for name, array in arrays.items() if array.dtype.kind in "fiu" and array.size <= _MOST_NUMBERS}
    return {name: array.item() if array.ndim == 0 else array.tolist() for name, array in small.items()}


def _cure(text: str) -> str:
    """What is wrong with the first line of a known fault; empty where there is none."""
    for number, line in enumerate(text.splitlines(), 1):
        if _BLANK_MISSING.match(line) and not line.startswith("%"):
            return f"line {number}: a blank is missing after the colon: {line.strip()[:60]!r}"
    return ""


def _json(text: str) -> Any:
    """None where the text is no JSON: YAML may begin with a brace, too."""
    try:
        return json.loads(text, object_pairs_hook=_unique)
    except json.JSONDecodeError:
        return None


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if found.setdefault(key, value) != value:
            raise ValueError(f"{key} is there twice, with two values")
    return found


def _xml(text: str) -> dict[str, Any]:
    """OpenCV's form of XML: a group of keys, matrices with their numbers in ``data``."""
    if "<!" in text.replace("<!--", ""):
        raise ValueError("declarations inside XML are not read")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"not XML: {error}") from error
    found = _element(root)
    return found if isinstance(found, dict) else {}


def _element(element: ElementTree.Element) -> Any:
    if len(element):
        return _unique([(one.tag, _element(one)) for one in element if one.tag != "_"])
    words = (element.text or "").split()
    return words if element.tag == "data" else " ".join(words).strip('"') or None


def _yaml(text: str) -> Any:
    """The first document that is not empty."""
    if text.startswith("%YAML"):  # OpenCV's "%YAML:1.0" is not what YAML allows there
        text = "#" + text
    loader = _Loader(_TAB.sub(" ", text))
    try:
        while loader.check_data():
            data = loader.get_data()
            if data is not None:
                return data
    finally:
        loader.dispose()
    return None


class _Loader(yaml.SafeLoader):
    """Scalars stay text; OpenCV's matrices are plain groups of keys."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012
    references = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            self.references += 1
            if self.references > _MAX_REFERENCES:
                raise ValueError(f"more than {_MAX_REFERENCES} references inside the file")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        found: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            key, value = self.construct_object(key_node, deep=True), self.construct_object(value_node, deep=True)
            if not isinstance(key, str | None):
                raise ValueError(f"line {key_node.start_mark.line + 1}: a key is one word")
            if found.setdefault(key, value) != value:
                line = key_node.start_mark.line + 1
                raise ValueError(f"line {line}: {key} is there twice, with two values")
        return found


def _group(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _group)
_Loader.add_constructor("tag:yaml.org,2002:map", _group)
_Loader.add_implicit_resolver("tag:yaml.org,2002:null", re.compile(r"(?:~|null|Null|NULL|)$"), ["~", "n", "N", ""])
