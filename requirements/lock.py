"""Rewrite the lock files from what is installed: ``make lock`` in an environment where everything passes.

``core.txt`` is the closure of the project's dependencies and of what builds it; ``worlds.txt`` adds what renders
(``make demo`` installs both), ``dev.txt`` the extras that the tests and the training of models use. Versions only, no
addresses: the packages come from wherever the user's pip is told to look.
"""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

HERE = Path(__file__).parent
DEV_EXTRAS = ("train", "evo", "rerun", "bags", "network", "docs", "dev")
LOCAL_VERSION = re.compile(r"\+.*$")  # "+cpu" names a build, not a release


def closure(requirements: list[str]) -> dict[str, str]:
    """Name to version of everything that ``requirements`` pull in here, themselves included."""
    found: dict[str, str] = {}
    seen: set[tuple[str, frozenset[str]]] = set()
    queue = [Requirement(text) for text in requirements]
    while queue:
        wanted = queue.pop()
        key = (canonicalize_name(wanted.name), frozenset(wanted.extras))
        if key in seen:
            continue
        seen.add(key)
        try:
            installed = distribution(wanted.name)
        except PackageNotFoundError:
            raise SystemExit(f"{wanted.name} is not installed here: run this in the environment to be locked") from None
        found[canonicalize_name(wanted.name)] = LOCAL_VERSION.sub("", installed.version)
        for text in installed.requires or []:
            needed = Requirement(text)
            if needed.marker is None or any(needed.marker.evaluate({"extra": extra}) for extra in {"", *wanted.extras}):
                queue.append(needed)
    return found


def main() -> None:
    """Write the files, each with what the ones before it do not hold."""
    settings = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    project, extras = settings["project"], settings["project"]["optional-dependencies"]
    core = closure([*project["dependencies"], *settings["build-system"]["requires"]])
    worlds = besides(core, extras["worlds"])
    dev = besides(core | worlds, [text for extra in DEV_EXTRAS for text in extras[extra]])
    write("core.txt", "What maslam needs to run.", core, "")
    write("worlds.txt", "What rendering needs besides: the lock file of `make demo`.", worlds, "-r core.txt\n")
    write("dev.txt", "What tests, training, documents need besides: for `make test`.", dev, "-r worlds.txt\n")


def besides(known: dict[str, str], requirements: list[str]) -> dict[str, str]:
    """The closure of ``requirements`` without what is ``known``."""
    return {name: version for name, version in closure(requirements).items() if name not in known}


def write(name: str, title: str, pins: dict[str, str], head: str) -> None:
    lines = "".join(f"{package}=={version}\n" for package, version in sorted(pins.items()))
    (HERE / name).write_text(f"# {title} Made by `make lock`.\n{head}{lines}", encoding="utf-8")


if __name__ == "__main__":
    main()
