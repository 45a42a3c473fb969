"""Every attribute that is read, by the class that declares it: a plugin for mypy, and a command that runs it.

mypy resolves types, so ``config.seed`` is told from ``other.seed``. ``python attribute_reads.py FILE ARGUMENT…`` calls
mypy with the arguments and writes a line for each read to FILE: class and attribute, file, line.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from mypy.nodes import MemberExpr
from mypy.plugin import AttributeContext, Plugin
from mypy.types import Type


class AttributeReads(Plugin):
    """Notes reads; the types stay as they are."""

    found: set[str] = set()  # noqa: RUF012 - of all instances: mypy makes its own

    def get_attribute_hook(self, fullname: str) -> Callable[[AttributeContext], Type] | None:
        def note(context: AttributeContext) -> Type:
            if isinstance(context.context, MemberExpr) and not context.is_lvalue:
                self.found.add(f"{fullname}\t{getattr(context.api, 'path', '')}\t{context.context.line}")
            return context.default_attr_type

        return note


def plugin(version: str) -> type[Plugin]:
    """What mypy asks for."""
    return AttributeReads


if __name__ == "__main__":
    from mypy import api

    output, errors, _ = api.run(sys.argv[2:])
    sys.stdout.write(output[-2000:] + errors)
    loaded = sys.modules[Path(__file__).stem]  # mypy imported this file once more, under its name
    Path(sys.argv[1]).write_text("\n".join(sorted(loaded.AttributeReads.found)), encoding="utf-8")
