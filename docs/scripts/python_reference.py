"""The Python pages of the reference: signatures and docstrings as Markdown."""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from typing import Any

_WIDTH = 100
_ROLE = re.compile(r":(?:class|func|mod|meth|data|attr):`~?([^`]+)`")

ENTRY_POINTS = (
    "maslam.frontend.datasets.open_dataset",
    "maslam.frontend.odometry.Odometry",
    "maslam.frontend.files.vo_files.read_tracks",
    "maslam.descriptors.inference.NetVlad",
    "maslam.descriptors.container.PlaceVectors",
    "maslam.descriptors.search.NearestIndex",
    "maslam.backend.relpose.verification.relative_pose",
    "maslam.backend.pose_graph.g2o.read_g2o",
    "maslam.backend.pose_graph.g2o.write_g2o",
    "maslam.backend.central.optimise.optimise",
    "maslam.backend.central.certificate.certify",
    "maslam.backend.trajectory_error.trajectory_error",
    "maslam.mas.sequence.load_sequences",
    "maslam.mas.simulation.run",
    "maslam.mas.agent.Agent",
    "maslam.mas.policies.base.Policy",
    "maslam.mas.policies.presets.preset",
    "maslam.mas.transport.transport.Transport",
    "maslam.mas.transport.transport.HandedOver",
)
"""The inner entry points that the documents send readers to."""


def public_names() -> list[str]:
    """The names of ``import maslam`` but its version, functions first."""
    names = [name for name in import_module("maslam").__all__ if not name.startswith("__")]
    return sorted(names, key=lambda name: (name[0].isupper(), name))


def page() -> str:
    """The public face, then the inner entry points."""
    lines = ["# Python", "", "Generated from signatures and docstrings.", ""]
    lines += ["## import maslam", "", "The public face. A change of it is announced in the changelog.", ""]
    face = import_module("maslam")
    for name in public_names():
        lines += _entry(f"maslam.{name}", getattr(face, name))
    lines += ["## Inner entry points", "", "What the face is made of; these may change between versions.", ""]
    for path in ENTRY_POINTS:
        module, _, name = path.rpartition(".")
        lines += _entry(path, getattr(import_module(module), name))
    return "\n".join(lines)


def _entry(path: str, thing: Any) -> list[str]:
    name = path.rpartition(".")[2]
    lines = [f"### {path}", "", "```python", _signature(name, thing), "```", "", prose(thing), ""]
    if not inspect.isclass(thing):
        return lines
    for member, what in vars(thing).items():
        inner = getattr(what, "__func__", what)
        if member.startswith("_") or not inspect.getdoc(inner) or not (callable(inner) or isinstance(what, property)):
            continue
        head = member if isinstance(what, property) else _signature(member, inner)
        lines += ["```python", head, "```", "", prose(inner), ""]
    return lines


def _signature(name: str, thing: Any) -> str:
    """As it stands in the code; a long one has a line for each parameter."""
    try:
        found = inspect.signature(thing)
    except (TypeError, ValueError):
        return name
    short = f"{name}{_unquoted(str(found))}".replace("(self, ", "(").replace("(self)", "()").replace("(cls, ", "(")
    if len(short) <= _WIDTH or not found.parameters:
        return short
    lines = []
    for parameter in found.parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and "    *," not in lines:
            lines.append("    *,")
        if parameter.name not in ("self", "cls"):
            lines.append(f"    {_unquoted(str(parameter))},")
    result = "" if found.return_annotation is found.empty else f" -> {found.return_annotation}"
    return "\n".join([f"{name}(", *lines, f"){result}"])


def _unquoted(signature: str) -> str:
    """Without the quotes around annotations."""
    return re.sub(r"(: |-> )'([^']*)'", r"\1\2", signature)


def prose(thing: Any) -> str:
    """A docstring as Markdown: roles and double back-ticks become code, entries of ``Args:`` and the like a list."""
    return as_markdown(inspect.getdoc(thing) or "")


def as_markdown(text: str) -> str:
    """Markdown of a docstring's text."""
    text = _ROLE.sub(lambda found: f"`{found.group(1)}`", text)
    text = re.sub(r"``([^`]+)``", r"`\1`", text)
    text = "".join(part if part[:1] == "`" else part.replace("<", "&lt;") for part in re.split(r"(`[^`]*`)", text))
    lines: list[str] = []
    listed = False
    for line in text.splitlines():
        if re.fullmatch(r"(Args|Returns|Raises|Yields):", line):
            lines, listed = [*lines, "", f"**{line[:-1]}**", ""], True
        elif listed and re.match(r" {4}\S", line):
            lines.append(f"- {line.strip()}")
        elif listed and line.startswith(" "):
            lines.append(f"  {line.strip()}")
        else:
            lines.append(line)
            listed = listed and not line
    return "\n".join(lines)
