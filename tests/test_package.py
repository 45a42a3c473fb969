"""The wheel beside other people's packages: it holds ``maslam`` only, runs, and its types are read.

The environment is new; the libraries that maslam needs come from the one that runs the tests, by a path file."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("backend", "descriptors", "frontend", "mas", "tools")
FOREIGN = ("tools", "mas", "backend")
IGNORED = shutil.ignore_patterns(".git", ".venv*", "__pycache__", "*.egg-info", "build", "demo", "tests", ".*_cache")
USER = """
from pathlib import Path

import maslam
from maslam.backend.geometry import Sim3
from maslam.backend.config import SolverConfig
from maslam.frontend.config import FeatureConfig, FlowConfig, KeyframeConfig, LostConfig, MappingConfig, MonoConfig
from maslam.frontend.config import PoseConfig, StereoConfig
from maslam.frontend.datasets import open_dataset
from maslam.mas.config import MasConfig, OptimisationConfig, PlacesConfig


def frames(folder: Path) -> int:
    return sum(len(sequence) for sequence in open_dataset(folder).sequences)


def mean_error(folder: Path) -> float | None:
    return maslam.slam(folder, "out", agents=4, seed=0).summary.ate_rmse_m.mean_agents


plain, named = MasConfig(), MasConfig(preset="default", places=PlacesConfig(code="int4"))
ours = MasConfig(optimisation=OptimisationConfig(solver=SolverConfig(method="elected")))
version: str = maslam.__version__
turned: Sim3 = Sim3.identity().inverse()
settings = maslam.OdometryConfig()
parts = (FeatureConfig(), FlowConfig(), StereoConfig(), PoseConfig(), KeyframeConfig())
slower = maslam.OdometryConfig(mapping=MappingConfig(window=20), mono=MonoConfig(), lost=LostConfig())
"""


def environment(path: str = "") -> dict[str, str]:
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PIP_", "PYTHON", "MYPY"))}
    return {**kept, "PIP_CONFIG_FILE": os.devnull, **({"PYTHONPATH": path} if path else {})}


def run(*words: object, cwd: Path, path: str = "", code: int = 0) -> str:
    done = subprocess.run(list(map(str, words)), cwd=cwd, env=environment(path), capture_output=True, text=True)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    work = tmp_path_factory.mktemp("wheel")
    shutil.copytree(ROOT, work / "source", symlinks=True, ignore=IGNORED)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "--quiet", "--no-index", "--no-deps")
    run(*pip, "--no-build-isolation", "--wheel-dir", work, work / "source", cwd=work)
    (built,) = work.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new environment with the wheel, and with packages of other people's that raise where they are imported."""
    home = tmp_path_factory.mktemp("environment")
    venv.create(home, symlinks=True)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", home / "bin" / "python")
    run(*pip, "install", "--quiet", "--no-index", "--no-deps", wheel, cwd=home)
    (site,) = home.glob("lib/python*/site-packages")
    libraries = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (site / "libraries.pth").write_text("\n".join(sorted(libraries)) + "\n")
    for where in (site, home / "ros"):
        for name in FOREIGN:
            (where / name).mkdir(parents=True)
            (where / name / "__init__.py").write_text("raise RuntimeError('somebody else')\n")
    return home


@pytest.mark.slow
def test_the_wheel_holds_real_files_of_maslam_only(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = [info.filename for info in archive.infolist()]
        links = [info.filename for info in archive.infolist() if (info.external_attr >> 16) & 0o170000 == 0o120000]
        (record,) = (name for name in names if name.endswith("/RECORD"))
        recorded = [line.split(",")[0] for line in archive.read(record).decode().splitlines()]
    assert links == [] and sorted(recorded) == sorted(names)
    assert {name.split("/")[0] for name in names} == {"maslam", record.split("/")[0]}
    sources = {f"maslam/{p.relative_to(ROOT)}" for folder in FOLDERS for p in (ROOT / folder).rglob("*.py")}
    sources |= {str(p.relative_to(ROOT)) for p in (ROOT / "maslam").rglob("*.py")}  # which follows no link
    assert {name for name in names if name.endswith(".py")} == sources
    data = {"maslam/py.typed", "maslam/frontend/vocabulary/vocabulary.npz", "maslam/tools/report/report.css"}
    data |= {f"maslam/descriptors/models/{p.name}" for p in (ROOT / "descriptors" / "models").iterdir()}
    assert {name for name in names if name.startswith("maslam/") and not name.endswith(".py")} == data


@pytest.mark.slow
def test_the_command_runs_beside_foreign_packages(installed: Path) -> None:
    ros = str(installed / "ros")
    assert "level 4: 10000 nodes" in run(installed / "bin" / "maslam", "vocabulary", "info", cwd=installed, path=ros)
    python = installed / "bin" / "python"
    assert run(python, "-m", "maslam", "--version", cwd=installed, path=ros).startswith("maslam ")
    where = "import maslam.mas.agent as a, maslam.tools.cli, sys; print(a.__file__, 'tools' in sys.modules)"
    file, foreign = run(python, "-c", where, cwd=installed, path=ros).split()
    assert installed in Path(file).parents and foreign == "False"
    run(python, "-c", "import tools", cwd=installed, path=ros, code=1)  # they do raise


def positional_defaults(source: str) -> list[int]:
    """Lines of fields whose default a type checker does not see: only ``default=`` is one to it (PEP 681)."""
    calls = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Call) and ast.unparse(n.func) == "Field"]
    return [n.lineno for n in calls if n.args]


def test_settings_have_defaults_for_a_type_checker_without_plugins() -> None:
    assert positional_defaults("a: int = Field(3)\nb: int = Field(default=3)") == [1]
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for folder in ("backend", "mas")
        for path in sorted((ROOT / folder).rglob("*.py"))
        for line in positional_defaults(path.read_text(encoding="utf-8"))
    ]
    assert found == []


@pytest.mark.slow
def test_a_users_script_is_type_checked(installed: Path) -> None:
    script = installed / "script.py"
    mypy = (sys.executable, "-m", "mypy", "--python-executable", installed / "bin" / "python", "--config-file=")
    script.write_text(USER)
    run(*mypy, script, cwd=installed, path=str(installed / "ros"))
    script.write_text(USER + "wrong: int = turned.inverse()\n")
    said = run(*mypy, script, cwd=installed, path=str(installed / "ros"), code=1)
    assert "Incompatible types in assignment" in said and "Found 1 error" in said
    script.write_text(USER + 'import maslam\nmaslam.slm("images", "out")\n')
    said = run(*mypy, script, cwd=installed, path=str(installed / "ros"), code=1)
    assert 'Module has no attribute "slm"' in said and "Found 1 error" in said
