"""Imports run down only: the table in ``docs/architecture.md``, held by reading every import in the five packages."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("backend", "frontend", "descriptors", "mas", "tools")
HEAVY = ("torch", "kornia", "open3d", "matplotlib", "gtsam", "pycolmap", "onnx", "rerun", "evo")
ALLOWED: dict[str, tuple[str, ...]] = {
    "backend": (),
    "frontend": ("maslam.backend.geometry",),
    "descriptors": (),
    "mas": (
        "backend",
        "maslam.frontend.files.vo_files", "maslam.frontend.files.trajectory", "maslam.frontend.errors", "maslam.frontend.cameras.models",
        "maslam.descriptors.container", "maslam.descriptors.inference", "maslam.descriptors.errors",
        "maslam.descriptors.card", "maslam.descriptors.clusters", "maslam.descriptors.codes", "maslam.descriptors.search",
    ),
    "tools": ("backend", "frontend", "descriptors", "mas"),
}  # fmt: skip
TORCH_SIDE = (
    "augmentation", "export", "gradients", "initialisation", "losses", "netvlad", "projection", "torch_checkpoint",
    "training", "vgg16",
)  # fmt: skip
"""Modules of ``descriptors`` that only training needs: torch is their subject, so nothing else may import them on
import."""
FILES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def imports(tree: ast.AST, package: str) -> list[tuple[int, str]]:
    """Line and full dotted name of everything imported anywhere in a file."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parent = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parent, base]).rstrip(".")
            found += [(node.lineno, f"{base}.{alias.name}") for alias in node.names]
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


def is_under(name: str, allowed: str) -> bool:
    return name == allowed or name.startswith(f"{allowed}.")


def violations(package: str, tree: ast.AST, module: str) -> list[str]:
    wrong = []
    for line, name in imports(tree, module):
        head = name.split(".")[0]
        if head not in PACKAGES or head == package:
            continue
        if not any(is_under(name, allowed) for allowed in ALLOWED[package]):
            wrong.append(f"line {line}: {package} may not import {name}")
    return wrong


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_run_down_only(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    module = ".".join(path.relative_to(ROOT).parent.parts)
    assert violations(package, ast.parse(path.read_text(encoding="utf-8")), module) == []


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_heavy_libraries_are_imported_where_they_are_used(path: Path) -> None:
    if path.parent == ROOT / "descriptors" and path.stem in TORCH_SIDE:
        pytest.skip("torch is its subject")
    outside = imports(
        top_level(ast.parse(path.read_text(encoding="utf-8"))), ".".join(path.relative_to(ROOT).parent.parts)
    )
    heavy = (*HEAVY, *(f"descriptors.{name}" for name in TORCH_SIDE))
    assert [f"line {line}: {name}" for line, name in outside if any(is_under(name, one) for one in heavy)] == []


def test_the_table_is_the_one_in_the_documents() -> None:
    rows = [
        line
        for line in (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8").splitlines()
        if line.startswith("| `")
    ]
    named = [row.split("`")[1].rstrip("/") for row in rows]
    assert sorted(named[: len(PACKAGES)]) == sorted(PACKAGES)


@pytest.mark.parametrize(
    ("package", "code", "wrong"),
    [
        ("frontend", "from maslam.backend.geometry import se3", 0),
        ("frontend", "def f():\n    from backend import graph", 1),
        ("frontend", "import maslam.backend.geometry, maslam.backend.pose_graph.graph", 1),
        ("backend", "from . import geometry", 0),
        ("backend", "from maslam.tools.cli import main", 1),
        ("mas", "from maslam.frontend.files.vo_files import read_tracks", 0),
        ("mas", "from frontend import odometry", 1),
        ("mas", "from descriptors import network", 1),
        ("tools", "import maslam.mas.agent", 0),
    ],
)
def test_the_test_itself(package: str, code: str, wrong: int) -> None:
    assert len(violations(package, ast.parse(code), package)) == wrong
