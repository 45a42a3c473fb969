"""Whether the dependencies can be installed for each Python that maslam supports: ``make resolve``.

pip resolves what ``pyproject.toml`` asks for, and what the lock files pin, for interpreters that need not be here; from
wheels alone, and nothing is installed. Exit code 1 where something does not resolve. Further arguments name platforms
of pip (``win_amd64``, ``macosx_14_0_arm64``); without any, this one.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

HERE = Path(__file__).parent
PYTHONS = ("3.11", "3.12", "3.13")


def wanted() -> dict[str, list[str]]:
    """Name to pip's arguments of everything that must resolve."""
    project = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    core = project["dependencies"]
    extras = [text for extra in project["optional-dependencies"].values() for text in extra]
    locked = {path.name: ["-r", str(path)] for path in sorted(HERE.glob("*.txt"))}
    return {"dependencies": core, "with all extras": [*core, *extras], **locked}


def resolve(arguments: list[str], python: str, platform: str = "") -> str:
    """Empty where it resolves, else pip's reason."""
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--quiet", "--disable-pip-version-check"]
    command += ["--only-binary=:all:", "--ignore-installed", "--python-version", python]
    command += ["--platform", platform] if platform else []
    with tempfile.TemporaryDirectory() as nowhere:
        done = subprocess.run([*command, "--target", nowhere, *arguments], capture_output=True, text=True)
    errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
    return "" if done.returncode == 0 else (errors or ["pip failed"])[-1]


def main(platforms: list[str]) -> int:
    """A line for each Python and set of dependencies."""
    failed = 0
    for platform in platforms or [""]:
        for python in PYTHONS:
            for name, arguments in wanted().items():
                reason = resolve(arguments, python, platform)
                failed += bool(reason)
                print(f"{platform or 'here':<18} Python {python}  {name:<16} {reason or 'ok'}", flush=True)  # noqa: T201
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
