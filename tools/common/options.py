"""Command-line options and YAML files from the configuration models: nothing is declared twice.

A field ``inliers`` of a nested model ``relpose`` is the option ``--relpose.inliers`` and the key ``relpose: {inliers:
…}`` in a file. Later wins: the model's defaults (or a preset), the file, the command line.
"""

from __future__ import annotations

import argparse
import enum
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from maslam._bounded import Unreadable, load_yaml, read_text
from maslam._suggestions import UNKNOWN_NAME, did_you_mean, hint

from .earlier_settings import modernised
from .errors import ToolError, UnknownName, UsageError
from .yaml_lines import place_of

Model = TypeVar("Model", bound=BaseModel)
DEST = "set:"  # marks the attributes of the parsed arguments that belong to a model


def add_model_options(parser: argparse.ArgumentParser, base: BaseModel, prefix: str = "") -> None:
    """One option for each leaf of ``base``'s model, in a group for each nested model.

    Its values are shown as the defaults; an option that is not given leaves no trace in the parsed arguments.
    """
    groups: dict[str, argparse._ArgumentGroup] = {}
    for path, field in leaves(type(base), prefix):
        section = path.rpartition(".")[0]
        if section not in groups:
            groups[section] = parser.add_argument_group(section or "settings")
        groups[section].add_argument(
            option_name(path),
            dest=DEST + path,
            default=argparse.SUPPRESS,
            metavar=_metavar(field.annotation),
            help=_help(field, _get(base, path[len(prefix) + 1 :] if prefix else path)),
        )


def option_name(path: str) -> str:
    """``relpose.min_inliers`` is ``--relpose.min-inliers``; the command line takes underscores for dashes as well."""
    return "--" + path.replace("_", "-")


def leaves(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """Dotted name and field of every setting that is no model itself."""
    for name, field in model.model_fields.items():
        path = f"{prefix}.{name}" if prefix else name
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from leaves(field.annotation, path)
        else:
            yield path, field


def build(
    base: Model,
    arguments: argparse.Namespace,
    file: Mapping[str, Any] | None = None,
    origin: Path | None = None,
    prefix: str = "",
) -> Model:
    """``base`` (defaults or a preset), overlaid with a file's keys, overlaid with the options given.

    :class:`ToolError` that names an unknown key or a value out of range; ``origin`` is the file, for the message.
    """
    model = type(base)
    values = base.model_dump()
    if file is not None and not isinstance(file, Mapping):
        raise ToolError(f"{origin}: {prefix or 'settings'}: expected keys and values, found {file!r}")
    if file:
        _overlay(values, file)
        _validate(model, values, _File(origin, prefix))
    for path, field in leaves(model, prefix):
        text = getattr(arguments, DEST + path, None)
        if text is not None:
            inner = path[len(prefix) + 1 :] if prefix else path
            _put(values, inner.split("."), _value(text, field.annotation))
            _validate(model, values, _Option(f"{option_name(path)} {text}"))
    return _validate(model, values, _File(None, prefix))


def overlaid(base: Model, changes: Mapping[str, Any], given: str) -> Model:
    """``base`` with ``changes`` that one option makes together; ``given``: option and value, for the message."""
    values = base.model_dump()
    _overlay(values, changes)
    return _validate(type(base), values, _Option(given))


def read_settings(path: Path | None, sections: Iterable[str] = ()) -> dict[str, Any]:
    """The settings in a YAML file, those of version 0.1 under today's names; none without a file.

    ``sections``: the keys that the file may have; any, where none is named. :class:`ToolError` for another, and for a
    file that is not YAML; :class:`UsageError` where there is no such file.
    """
    if path is None:
        return {}
    if not path.exists():
        raise UsageError(f"{path}: no such file")
    content, known = modernised(read_yaml(path), path), list(sections)
    for name in content:
        if known and name not in known:
            where = place_of(path, [str(name)])
            raise UnknownName(f"{where}: unknown setting '{name}'{did_you_mean(str(name), known)}")
    return content


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file of settings; anything but a mapping is an error."""
    try:
        content = load_yaml(read_text(path))
    except Unreadable as error:
        raise ToolError(f"{path}: {error}") from error
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ToolError(f"{path}: expected keys and values, found a {type(content).__name__}")
    return content


def size(text: str, option: str = "--size") -> tuple[int, int]:
    """Width and height in pixels of ``640x360``; ``UsageError``, which names the ``option``, for anything else."""
    sides = text.lower().split("x")
    if len(sides) != 2 or not all(side.isdecimal() and int(side) > 0 for side in sides):
        raise UsageError(f"{option} {text}: width and height in pixels are meant, like 640x360")
    return int(sides[0]), int(sides[1])


@dataclass(frozen=True)
class _Option:
    """``given``: an option and its value, as they were written."""

    given: str

    def place(self, name: str) -> str:
        return self.given

    def whole(self, name: str) -> str:
        return name

    error: ClassVar[type[ToolError]] = UsageError


@dataclass(frozen=True)
class _File:
    """A settings file; ``prefix``: the section of it that is meant."""

    path: Path | None
    prefix: str

    def place(self, name: str) -> str:
        return place_of(self.path, self.whole(name).split(".")) if self.path else "the settings"

    def whole(self, name: str) -> str:
        return ".".join(part for part in (self.prefix, name) if part)

    error: ClassVar[type[ToolError]] = ToolError


def _overlay(values: dict[str, Any], changes: Mapping[str, Any]) -> None:
    for key, change in changes.items():
        if isinstance(change, Mapping) and isinstance(values.get(key), dict):
            _overlay(values[key], change)
        else:
            values[key] = change


def _put(values: dict[str, Any], path: list[str], value: object) -> None:
    for key in path[:-1]:
        values = values[key]
    values[path[-1]] = value


def _validate(model: type[Model], values: dict[str, Any], source: _File | _Option) -> Model:
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise _said(model, error.errors()[0], source) from None


def _said(model: type[BaseModel], first: ErrorDetails, source: _File | _Option) -> ToolError:
    """The first thing that a model found wrong, in one line for people."""
    name = ".".join(str(part) for part in first["loc"])
    fields = dict(leaves(model))
    setting = next((path for path in fields if name == path or name.startswith(f"{path}.")), name)
    place, whole = source.place(setting), source.whole(name)
    if first["type"] == "extra_forbidden":
        known = [source.whole(path) for path in (*fields, *_sections(fields))]
        return UnknownName(f"{place}: unknown setting '{whole}'{did_you_mean(whole, known)}")
    if first["type"] == UNKNOWN_NAME:
        return UnknownName(f"{place}: {whole}: {first['msg']}")
    given = f", not {first['input']!r}" if first["loc"] and not isinstance(first["input"], dict) else ""
    message = first["msg"][0].lower() + first["msg"][1:] + given
    if first["type"] in {"literal_error", "enum"}:
        near = hint(str(first["input"]), choices(fields[setting].annotation)) if setting in fields else ""
        return UnknownName(f"{place}: {whole}: {message}{near}")
    return source.error(f"{place}: {whole}: {message}" if name else f"{place}: {message}")


def _sections(paths: Iterable[str]) -> set[str]:
    return {path[:k] for path in paths for k, letter in enumerate(path) if letter == "."}


def choices(annotation: Any) -> list[str]:
    """The words that a setting of this type takes; empty where it is no choice."""
    words: list[str] = []
    for kind in _kinds(annotation):
        if typing.get_origin(kind) is typing.Literal:
            words += [str(value) for value in typing.get_args(kind)]
        elif isinstance(kind, type) and issubclass(kind, enum.Enum):
            words += [str(member.value) for member in kind]
    return words


def _value(text: str, annotation: Any) -> object:
    """Text as pydantic may convert it: only lists and mappings are parsed here; ``none`` is None where a field may be
    that.
    """
    kinds = _kinds(annotation)
    if type(None) in kinds and text.lower() in {"none", "null"}:
        return None
    if any(typing.get_args(kind)[:1] == (str,) for kind in kinds) and text[:1] not in "[{":
        return [word.strip() for word in text.split(",")]  # YAML would take 08 for a word and 07 for a number
    for kind in kinds:
        if typing.get_origin(kind) is typing.Literal:
            named = {str(value): value for value in typing.get_args(kind)}
            return named.get(text, text)  # a choice may be a number
    if any((typing.get_origin(kind) or kind) in (tuple, list, dict, set, frozenset) for kind in kinds):
        try:
            return load_yaml(text if text[:1] in "[{" else f"[{text}]")
        except Unreadable:
            return text  # which is none of what is meant, and is refused with the option's name
    return text


def _kinds(annotation: Any) -> tuple[Any, ...]:
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return tuple(typing.get_args(annotation))
    return (annotation,)


def _metavar(annotation: Any) -> str:
    words: list[str] = []
    for kind in _kinds(annotation):
        if choices(kind):
            words += choices(kind)
        elif kind is bool:
            words += ["true", "false"]
        elif kind is type(None):
            words.append("none")
        elif typing.get_origin(kind) is tuple:
            words.append(f"{_metavar(typing.get_args(kind)[0])},...")
        elif kind is str:
            words.append("NAME")
        else:
            words.append(getattr(typing.get_origin(kind) or kind, "__name__", "value").upper())
    return "|".join(words)


def _get(model: BaseModel, path: str) -> Any:
    for name in path.split("."):
        model = getattr(model, name)
    return model


def _help(field: FieldInfo, default: Any) -> str:
    return f"{field.description + ' ' if field.description else ''}(default: {_shown(default)})".replace("%", "%%")


def _shown(value: Any) -> str:
    """A value as it may be given on the command line."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return ",".join(_shown(one) for one in value) or "[]"
    return str(value.value if isinstance(value, enum.Enum) else value)
