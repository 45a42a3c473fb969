"""No setting and no option that nothing reads: who sets it would wait for an effect that never comes."""

from __future__ import annotations

import argparse
import ast
import importlib
import inspect
import os
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

import pytest
from pydantic import BaseModel

from maslam.tools import cli
from maslam.tools.common.options import DEST

ROOT = Path(__file__).resolve().parents[2]
PREFIX = "maslam."  # of a module's name before its folder's
FOLDERS = ("frontend", "descriptors", "backend", "mas", "tools")
PACKAGES: list[str] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mypy"]["packages"]
PLUGIN = Path(__file__).with_name("attribute_reads.py")
SETTINGS = """\
[mypy]
packages = {packages}
plugins = {plugin}
ignore_missing_imports = True
follow_imports = silent
[mypy-numpy.*,scipy.*,pydantic.*,matplotlib.*,rich.*,msgspec.*,cv2.*,gtsam.*,open3d.*,pycolmap.*,numba.*,kornia.*]
follow_imports = skip
[mypy-onnxruntime.*,onnx.*,rerun.*,torch.*,yaml.*,evo.*,ray.*]
follow_imports = skip
"""
"""Libraries are skipped: only the types of our own classes matter here, and mypy takes a third of the time."""


def attribute_reads(folder: Path, packages: list[str], root: Path) -> set[tuple[str, str, int]]:
    """``(module.Class.attribute, file, line)`` of every read in ``packages`` under ``root``."""
    config, found = folder / "mypy.ini", folder / "reads"
    config.write_text(SETTINGS.format(packages=", ".join(packages), plugin=PLUGIN), encoding="utf-8")
    mypy = ["--config-file", str(config), "--cache-dir", os.devnull]
    done = subprocess.run([sys.executable, str(PLUGIN), str(found), *mypy], cwd=root, capture_output=True, text=True)
    assert found.is_file(), done.stdout + done.stderr
    lines = [line.split("\t") for line in found.read_text(encoding="utf-8").splitlines()]
    return {(name, str((root / path).resolve()), int(line)) for name, path, line in lines}


def config_models() -> Iterator[type[BaseModel]]:
    """Every model whose fields somebody can set: by the names that all of them have."""
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if "BaseModel" in (text := path.read_text(encoding="utf-8")) or "(Settings)" in text:
                module = PREFIX + ".".join(path.relative_to(ROOT).with_suffix("").parts)
                for name, one in vars(importlib.import_module(module)).items():
                    if name.endswith(("Config", "Plan")) and is_model(one) and one.__module__ == module:
                        yield one


def is_model(one: object) -> bool:
    return inspect.isclass(one) and issubclass(one, BaseModel)


def validator_lines(model: type[BaseModel]) -> set[int]:
    """Lines of the checks in ``model``'s own body: what is only checked is not used."""
    lines, first = inspect.getsourcelines(model)
    body = ast.parse(textwrap.dedent("".join(lines))).body[0]
    assert isinstance(body, ast.ClassDef)
    checks = [
        node
        for node in body.body
        if isinstance(node, ast.FunctionDef) and any("validator" in ast.unparse(one) for one in node.decorator_list)
    ]
    return {line for node in checks for line in range(first + node.lineno - 1, first + (node.end_lineno or 0))}


def unread(models: list[type[BaseModel]], reads: set[tuple[str, str, int]]) -> list[str]:
    """Fields of ``models`` that are read nowhere, or only by their own checks."""
    missing = []
    for model in models:
        own, checks = str(Path(inspect.getsourcefile(model) or "").resolve()), validator_lines(model)
        used = {name for name, path, line in reads if not (path == own and line in checks)}
        names = [name for name in vars(model)["__annotations__"] if name in model.model_fields]
        missing += [
            f"{model.__qualname__}.{name}"
            for name in names
            if f"{model.__module__}.{model.__qualname__}.{name}" not in used
        ]
    return missing


@pytest.mark.slow
def test_every_setting_is_read(tmp_path: Path) -> None:
    models = list(config_models())
    assert len(models) > 20
    assert unread(models, attribute_reads(tmp_path, PACKAGES, ROOT)) == []


class ExampleConfig(BaseModel):
    used: int = 1
    ignored: int = 2


def test_a_read_of_another_class_does_not_count() -> None:
    used = (f"{__name__}.ExampleConfig.used", "elsewhere.py", 3)
    other = (f"{__name__}.OtherConfig.ignored", "elsewhere.py", 4)
    assert unread([ExampleConfig], {used, other}) == ["ExampleConfig.ignored"]


def test_the_trace_tells_classes_apart(tmp_path: Path) -> None:
    package = tmp_path / "sample"
    package.mkdir()
    (package / "__init__.py").write_text(
        "class A:\n    seed: int = 0\nclass B:\n    seed: int = 0\n\ndef f(a: A, b: B) -> int:\n    return a.seed\n"
    )
    assert {name for name, _, _ in attribute_reads(tmp_path, ["sample"], tmp_path)} == {"sample.A.seed"}


def parsers(parser: argparse.ArgumentParser, name: str) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """A command's parser, and those of its actions."""
    nested = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    yield name, parser
    for action in nested:
        for choice, one in action.choices.items():
            yield from parsers(one, f"{name} {choice}")


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_option_of_a_command_is_read(command: str) -> None:
    (all_commands,) = (a for a in cli.build_parser(command)._actions if isinstance(a, argparse._SubParsersAction))
    words = read_words()
    for name, parser in parsers(all_commands.choices[command], command):
        own = {action.dest for action in parser._actions if not action.dest.startswith(DEST)} - {"help", "help_all"}
        assert [f"{name} {dest}" for dest in own if not any(fnmatch(dest, word) for word in words)] == []


def read_words() -> set[str]:
    """``x`` of every ``arguments.x`` in the commands, and of every ``getattr(arguments, "x")``; of an f-string a
    pattern."""
    found = set()
    for path in (ROOT / "tools").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "arguments":
                found.add(node.attr)
            elif isinstance(node, ast.Call) and ast.unparse(node.func) == "getattr":
                found |= {pattern(name) for name in node.args[1:2] if "arguments" in ast.unparse(node.args[0])}
            elif isinstance(node, ast.DictComp | ast.GeneratorExp) and "getattr(arguments, " in ast.unparse(node):
                found |= {str(one.value) for one in ast.walk(node) if isinstance(one, ast.Constant)}  # names in turn
    return found


def pattern(name: ast.expr) -> str:
    """``input_*`` of ``f"input_{name}"``; of an expression without any text nothing, which no option is called."""
    parts = name.values if isinstance(name, ast.JoinedStr) else [name]
    text = "".join(str(part.value) if isinstance(part, ast.Constant) else "*" for part in parts)
    return "" if text == "*" else text
