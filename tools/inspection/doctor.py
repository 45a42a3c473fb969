"""``maslam doctor``: versions, missing system libraries, models, and what works on this machine."""

from __future__ import annotations

import argparse
import importlib
import math
import platform
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version

from maslam.descriptors.session import load_onnxruntime

from ..common.errors import describe
from ..common.memory import resident_mb

IMPORT_NAMES = {
    "opencv-contrib-python-headless": "cv2",
    "pyyaml": "yaml",
    "rerun-sdk": "rerun",
}
DEBIAN_PACKAGE = {
    "libusb-1.0.so": "libusb-1.0-0",
    "libGL.so": "libgl1",
    "libgomp.so": "libgomp1",
    "libX11.so": "libx11-6",
}
PURPOSE = {
    "worlds": "rendering synthetic images (`maslam demo`, `render`, `sweep`)",
    "train": "training and exporting the place descriptor",
    "rerun": "recordings for the rerun viewer (`maslam report RUN --rrd`)",
    "evo": "comparing trajectories with evo",
}

LINKED_TO_THE_SYSTEM = ("worlds",)


@dataclass(frozen=True)
class Check:
    """One line of the answer: ``needed`` ones decide the exit code."""

    name: str
    works: bool
    detail: str
    needed: bool = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Nothing can be set."""


def main(_: argparse.Namespace) -> int:
    """Print the checks; 1 where something needed is missing."""
    from ..common.parallel import core_count

    print(
        f"maslam {version('maslam')}, Python {platform.python_version()}, {platform.platform()}, {core_count()} cores\n"
    )
    checks = [*system_checks(), *library_checks(), *model_checks(), *extra_checks()]
    width = max(len(check.name) for check in checks)
    for check in checks:
        mark = "ok     " if check.works else "MISSING" if check.needed else "absent "
        print(f"{mark}  {check.name:<{width}}  {check.detail}")
    broken = [check for check in checks if check.needed and not check.works]
    print("\n" + (f"{len(broken)} needed parts do not work" if broken else "everything needed works"))
    return 1 if broken else 0


def system_checks() -> list[Check]:
    """Checks of the operating system, excluding libraries."""
    name = platform.system()
    tested = "tested" if name == "Linux" else "not tested there; what cannot work says so in a line"
    measured = not math.isnan(resident_mb())
    return [
        Check("system", name == "Linux", f"{name or 'unknown'}: {tested}", needed=False),
        Check("memory figures", measured, "`maslam bench` measures memory", needed=False),
        kernel_cache_check(),
    ]


def kernel_cache_check() -> Check:
    """Where compiled kernels are kept."""
    from maslam._kernel_cache import CURE, take_notes
    from maslam.backend.relpose.kernels import VERIFICATION_KERNELS

    first, _ = VERIFICATION_KERNELS[0]
    where = first.stats.cache_path
    notes = "; ".join(take_notes())  # kept elsewhere than usual, which works as well; or nowhere
    return Check("kernel cache", where is not None, notes or f"{where} ({CURE})", needed=False)


def library_checks() -> list[Check]:
    """Every dependency imported for real: a wheel that is installed may still miss a library of the system. What is
    not made for this system is not needed on it."""
    wanted = [text for text in requires("maslam") or [] if "extra ==" not in text]
    elsewhere = re.compile(rf"sys_platform *!= *['\"]{sys.platform}['\"]")
    return [_import_check(_name(text), needed=elsewhere.search(text) is None) for text in wanted]


def extra_checks() -> list[Check]:
    """The optional parts, by what they are for; those that need libraries of the system are imported for real."""
    checks = []
    for extra, purpose in PURPOSE.items():
        names = [_name(text) for text in requires("maslam") or [] if re.search(rf"extra == ['\"]{extra}['\"]", text)]
        missing = [name for name in names if not _installed(name)]
        detail = purpose if not missing else f"{purpose}: pip install 'maslam[{extra}]'"
        checks.append(Check(f"extra: {extra}", not missing, detail, needed=False))
        if extra in LINKED_TO_THE_SYSTEM:
            checks += [_import_check(name, needed=False) for name in names if name not in missing]
    return checks


def model_checks() -> list[Check]:
    """The shipped models, loaded."""

    def place_model() -> str:
        from maslam.descriptors.inference import NetVlad
        from maslam.descriptors.session import available_providers

        model = NetVlad.load("default")
        runs_on = ", ".join(name.removesuffix("ExecutionProvider") for name in available_providers())
        return f"{model.name} ({model.sha256[:12]}), {model.dim} numbers; onnxruntime runs it on {runs_on}"

    def vocabulary() -> str:
        from maslam.frontend.vocabulary.vocabulary import Vocabulary

        Vocabulary.load(None)
        return "loads"

    return [_tried("place descriptor", place_model), _tried("vocabulary", vocabulary)]


def _import_check(name: str, needed: bool) -> Check:
    def tried() -> str:
        if name == "onnxruntime":
            load_onnxruntime()  # with its telemetry off
        else:
            importlib.import_module(IMPORT_NAMES.get(name, name).replace("-", "_"))
        return version(name)

    return _tried(name, tried, needed)


def _tried(name: str, work: Callable[[], str], needed: bool = True) -> Check:
    try:
        return Check(name, True, work(), needed)
    except Exception as error:  # noqa: BLE001 - any failure at all is what this command is there to show
        text = describe(error)
        package = next((package for library, package in DEBIAN_PACKAGE.items() if library in text), None)
        return Check(name, False, f"{text}{f'; Debian, Ubuntu: apt-get install {package}' if package else ''}", needed)


def _installed(name: str) -> bool:
    try:
        return bool(version(name))
    except PackageNotFoundError:
        return False


def _name(requirement: str) -> str:
    match = re.match(r"[A-Za-z0-9._-]+", requirement)
    return match.group().lower() if match else requirement
