"""Small rendered data sets that all tests share: rendered once a session, also when several processes run the tests."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings
from pydantic import BaseModel

try:
    import fcntl
except ImportError:  # Windows: run the tests in one process there
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from maslam.tools.worlds.config import RenderConfig

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # tests import onnxruntime on their own, too

# The same examples each run; other ones with --hypothesis-profile=random.
settings.register_profile("random")
settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")

Rendered = Callable[[str, "RenderConfig"], Path]


class NoBareNames(MetaPathFinder):
    """Refuses the folders' bare names: with the root of the checkout on the path, as ``python -m pytest`` puts it, a
    module could be loaded a second time under another name."""

    folders = ("backend", "descriptors", "frontend", "mas", "tools")

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: object = None) -> None:
        if fullname in self.folders:
            raise ImportError(f"import maslam.{fullname}, not {fullname}")


sys.meta_path.insert(0, NoBareNames())


def refuse_unknown_fields() -> None:
    """``model_copy(update=...)`` of a field that is none is an error in tests: pydantic takes it in silence, and the
    test runs with other settings than it says."""
    plain = BaseModel.model_copy

    def model_copy(self: BaseModel, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> BaseModel:
        unknown = set(update or {}) - type(self).model_fields.keys()
        if unknown:
            raise TypeError(f"{type(self).__name__} has no field {sorted(unknown)}")
        return plain(self, update=update, deep=deep)

    BaseModel.model_copy = model_copy  # type: ignore[method-assign, assignment]


refuse_unknown_fields()


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Rendered:
    """``rendered(name, config)``: the folder of that rendering, made by whichever process asks first. Read it, never
    write to it."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base

    def render(name: str, config: RenderConfig) -> Path:
        from maslam.tools.worlds.dataset import render_dataset

        with open(shared / f"{name}.lock", "w") as lock:
            if fcntl is not None:
                fcntl.flock(lock, fcntl.LOCK_EX)
            render_dataset(config, shared / name)
        return shared / name

    return render


@pytest.fixture(scope="session")
def town_stereo(rendered: Rendered) -> Path:
    """Two cars in town, stereo 320x180, 20 frames each at 10 Hz; the second drives where the first did, in another
    light."""
    from maslam.tools.worlds.config import RenderConfig

    return rendered("town_stereo", RenderConfig(seed=5, agents=2, frames=20, width=320, height=180, cheap=True))


@pytest.fixture(scope="session")
def indoor_rgbd(rendered: Rendered) -> Path:
    """Two walkers on one office floor, RGB-D 320x240, 16 frames each at 10 Hz."""
    from maslam.tools.worlds.config import RenderConfig

    config = RenderConfig(world="indoor", rig="rgbd", seed=5, agents=2, frames=16, width=320, height=240, cheap=True)
    return rendered("indoor_rgbd", config)
