"""What import-linter cannot hold of the borders (``.importlinter``): when heavy libraries are imported, one name for
each module, one name for each class."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from collections import Counter
from configparser import ConfigParser
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("backend", "descriptors", "frontend", "mas", "tools")
HEAVY = ("torch", "kornia", "open3d", "matplotlib", "gtsam", "pycolmap", "onnx", "rerun", "evo")
TORCH_SIDE = ("maslam.descriptors.training", "maslam.descriptors.published")
"""Rooms whose subject is torch and other people's weights: nothing else imports them on import."""
FILES = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
FACE = [path for folder in ("maslam", "maslam/api") for path in sorted((ROOT / folder).glob("*.py"))]
"""Above and below the folders: the public face, errors, extensions."""
ADAPTERS = {
    "pycolmap": "maslam._pycolmap",
    "gtsam": "maslam.backend.central.gtsam_adapter",
    "open3d": "maslam.tools.worlds.rendering.renderer",
}
"""The one module that calls a library whose interface moves."""


def name_of(path: Path) -> str:
    """``maslam.backend.geometry`` of ``backend/geometry.py``, of a package's ``__init__.py`` the package."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts if parts[0] == "maslam" else ("maslam", *parts)).removesuffix(".__init__")


def imports(tree: ast.AST, package: str) -> list[tuple[int, str]]:
    """Line and full dotted name of everything imported anywhere in a file of ``package``."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")
            base = parents[: len(parents) - node.level + 1] if node.level else []
            found += [(node.lineno, ".".join([*base, *filter(None, [node.module]), a.name])) for a in node.names]
    return found


def top_level(tree: ast.Module) -> ast.Module:
    """What runs on import: functions' bodies and blocks for type checkers left out."""

    class Outside(ast.NodeTransformer):
        def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
            return None

        def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> None:
            return None

        def visit_If(self, node: ast.If) -> ast.AST | None:
            return None if "TYPE_CHECKING" in ast.dump(node.test) else self.generic_visit(node)

    return Outside().visit(tree)


def is_under(name: str, rooms: tuple[str, ...]) -> bool:
    return any(name == room or name.startswith(f"{room}.") for room in rooms)


def imported_on_import(code: str, package: str, unwanted: tuple[str, ...]) -> list[str]:
    found = imports(top_level(ast.parse(code)), package)
    return [f"line {line}: {name}" for line, name in found if is_under(name, unwanted)]


@pytest.mark.parametrize("path", FILES + FACE, ids=lambda path: str(path.relative_to(ROOT)))
def test_heavy_libraries_are_imported_where_they_are_used(path: Path) -> None:
    if is_under(name_of(path), TORCH_SIDE):
        pytest.skip("torch is its subject")
    package = name_of(path.with_name("__init__.py"))
    assert imported_on_import(path.read_text(encoding="utf-8"), package, (*HEAVY, *TORCH_SIDE)) == []


@pytest.mark.parametrize(
    ("package", "code", "wrong"),
    [
        ("maslam.mas", "import torch", 1),
        ("maslam.mas", "def f():\n    import torch", 0),
        ("maslam.mas", "if TYPE_CHECKING:\n    import torch", 0),
        ("maslam.descriptors", "from .training import losses", 1),
        ("maslam.descriptors.published", "from ..training.network import NetVlad", 1),
        ("maslam.tools.netvlad", "from maslam.descriptors.published.vgg16 import Vgg16", 1),
        ("maslam.tools.netvlad", "from .train import run", 0),
    ],
)
def test_the_test_itself(package: str, code: str, wrong: int) -> None:
    assert len(imported_on_import(code, package, (*HEAVY, *TORCH_SIDE))) == wrong


@pytest.mark.parametrize("library", ADAPTERS)
def test_a_library_whose_interface_moves_has_one_adapter(library: str) -> None:
    callers = set()
    for path in FILES + FACE:
        found = imports(ast.parse(path.read_text(encoding="utf-8")), name_of(path.with_name("__init__.py")))
        callers |= {name_of(path) for _, name in found if is_under(name, (library,))}
    assert callers == {ADAPTERS[library]}


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_folder_cannot_be_imported_by_its_bare_name(folder: str) -> None:
    """Whoever runs ``python -m pytest`` has the root of the checkout on the path; ``conftest.py`` refuses."""
    with pytest.raises(ImportError, match=f"maslam.{folder}"):
        importlib.import_module(folder)


def test_every_module_is_loaded_once_and_under_one_name() -> None:
    names = [name for name in map(name_of, FILES + FACE) if not is_under(name, TORCH_SIDE)]
    names.remove("maslam.__main__")
    code = (
        "import importlib, os, sys\n"
        f"for name in {names!r}: importlib.import_module(name)\n"
        "files = {n: os.path.realpath(m.__file__) for n, m in sys.modules.items() if getattr(m, '__file__', None)}\n"
        f"ours = {{n: f for n, f in files.items() if f.startswith({str(ROOT)!r} + os.sep) and '.venv' not in f}}\n"
        "print(sorted(n for n in ours if n.split('.')[0] != 'maslam'), len(ours) - len(set(ours.values())), len(ours))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[-2] == f"[] 0 {len(names)}"


def test_no_class_name_occurs_twice() -> None:
    classes = [
        node.name
        for path in FILES
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef)
    ]
    assert [name for name, count in Counter(classes).items() if count > 1] == []


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_documents_name_the_rooms_of_the_contracts(folder: str) -> None:
    """``docs/architecture.md`` gives each folder, and but for ``descriptors`` each room of it, a row."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    cells = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    named = {name.rstrip("/") for cell in cells for name in re.findall(r"`([^`]+)`", cell)}
    config = ConfigParser()
    config.read(ROOT / ".importlinter")
    rooms = set(re.findall(r"\w+", config[f"importlinter:contract:{folder}"]["layers"])) - {"config", "errors"}
    assert folder in named
    assert folder == "descriptors" or {name for name in named if name.startswith(f"{folder}/")} == {
        f"{folder}/{room}" for room in rooms
    }
