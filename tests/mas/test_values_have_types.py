"""Values that travel together are a type: no function of mas/ hands on a tuple of three or more different things."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

MAS = Path(__file__).resolve().parents[2] / "mas"
LONGEST = 2
"""A pair may travel as one."""


def handed_on(tree: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    """What functions take and return, and what attributes of classes hold, by name; locals are nobody else's."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            if node.returns is not None:
                yield f"{node.name} returns", node.returns
            given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            yield from ((f"{node.name}({a.arg})", a.annotation) for a in given if a.annotation is not None)
        elif isinstance(node, ast.ClassDef):
            fields = [n for n in ast.walk(node) if isinstance(n, ast.AnnAssign)]
            for field in fields:
                attribute = isinstance(field.target, ast.Attribute) or field in node.body
                if attribute:
                    yield f"{node.name}.{ast.unparse(field.target)}", field.annotation


def long_tuples(source: str) -> list[str]:
    """Names of those that are or hold a tuple of more than ``LONGEST`` values of fixed meaning."""
    return [
        name
        for name, annotation in handed_on(ast.parse(source))
        for part in ast.walk(annotation)
        if isinstance(part, ast.Subscript)
        and ast.unparse(part.value) == "tuple"
        and isinstance(part.slice, ast.Tuple)
        and len(part.slice.elts) > LONGEST
    ]


def test_the_rule_sees_what_it_forbids() -> None:
    source = """
class A:
    sold: set[tuple[int, int, int]]
    def __init__(self, x: tuple[int, str, str]) -> None:
        self.held: list[tuple[int, int, bytes]] = []
        local: list[tuple[int, int, int]] = []
    def f(self, many: tuple[int, ...], pair: tuple[int, int]) -> tuple[int, float, str] | None: ...
"""
    assert sorted(long_tuples(source)) == ["A.self.held", "A.sold", "__init__(x)", "f returns"]


@pytest.mark.parametrize("path", sorted(MAS.rglob("*.py")), ids=lambda p: str(p.relative_to(MAS)))
def test_no_long_tuple_travels(path: Path) -> None:
    assert long_tuples(path.read_text(encoding="utf-8")) == []
