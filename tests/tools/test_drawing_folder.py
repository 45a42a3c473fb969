"""Charts where neither a home nor a temporary folder can be written: a user who may write OUT alone."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

DRAW = """
import sys, tempfile
from pathlib import Path
tempfile._candidate_tempdir_list = lambda: ["/proc/none"]
from maslam.tools.common.drawing_folder import drawing_folder
from maslam.tools.common.figures import saved_figure
with saved_figure(Path(sys.argv[1]), (2.0, 2.0)) as figure:
    figure.add_subplot().set_title("drawn")
"""


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a folder that root cannot make")
def test_a_chart_needs_no_folder_but_its_own(tmp_path: Path) -> None:
    environment = {
        k: v for k, v in os.environ.items() if k not in ("MPLCONFIGDIR", "XDG_CONFIG_HOME", "XDG_CACHE_HOME")
    }
    root = str(Path(__file__).resolve().parents[2])
    environment |= {"HOME": "/proc/none", "PYTHONPATH": root}
    out = tmp_path / "out" / "chart.png"
    command = [sys.executable, "-c", DRAW, str(out)]
    done = subprocess.run(command, env=environment, cwd="/proc", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert out.stat().st_size > 1000 and [path.name for path in out.parent.iterdir()] == ["chart.png"]
