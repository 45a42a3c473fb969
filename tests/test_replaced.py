"""Changed copies of settings: a field that is none is an error, in the product as in the tests."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from maslam._replaced import replaced
from maslam.mas.config import MasConfig

ROOT = Path(__file__).resolve().parent.parent
PRODUCT = [
    p for f in ("backend", "descriptors", "frontend", "mas", "tools", "examples") for p in (ROOT / f).rglob("*.py")
]
PRODUCT += [p for f in ("maslam", "maslam/api") for p in (ROOT / f).glob("*.py")]


def test_a_field_is_changed_and_the_rest_is_kept() -> None:
    config = MasConfig(step_s=0.25)
    assert replaced(config, seed=3) == MasConfig(step_s=0.25, seed=3) and config.seed == 0


def test_a_field_that_is_none_is_named_with_what_is_near() -> None:
    with pytest.raises(TypeError, match=r"MasConfig has no field 'reputatoin'; did you mean 'reputation'\?"):
        replaced(MasConfig(), reputatoin=1)


def test_tests_do_not_set_what_is_not_there() -> None:
    with pytest.raises(TypeError, match="MasConfig has no field"):
        MasConfig().model_copy(update={"standing": 1})


def unchecked(tree: ast.AST) -> list[int]:
    """Lines of copies that take any name."""
    calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call) and isinstance(n.func, ast.Attribute)]
    copies = [n for n in calls if n.func.attr == "model_copy"]  # type: ignore[attr-defined]
    return [n.lineno for n in copies if n.args or any(k.arg in ("update", None) for k in n.keywords)]


def test_the_product_copies_settings_by_the_checked_way_alone() -> None:
    assert unchecked(ast.parse("a.model_copy(update=b)\na.model_copy()")) == [1]
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in PRODUCT
        if path.name != "_replaced.py"
        for line in unchecked(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert len(PRODUCT) > 300 and found == []
