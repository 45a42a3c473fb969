"""Scripts without ``if __name__ == "__main__":``, which every new process imports again."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCRIPT = """
import sys
import maslam
run = maslam.preprocess({images!r}, {out!r}{workers})
print("made", len(run.agents))
"""


def script(tmp_path: Path, images: Path, workers: str) -> subprocess.CompletedProcess[str]:
    path = tmp_path / "script.py"
    path.write_text(SCRIPT.format(images=str(images), out=str(tmp_path / "out"), workers=workers))
    return subprocess.run([sys.executable, str(path)], capture_output=True, text=True, timeout=300, check=False)


def test_a_script_without_a_guard_runs_once(tmp_path: Path, town_stereo: Path) -> None:
    done = script(tmp_path, town_stereo, "")
    assert (done.returncode, done.stdout) == (0, "made 2\n"), done.stderr


def test_several_workers_without_a_guard_end_in_a_line_that_says_so(tmp_path: Path, town_stereo: Path) -> None:
    done = script(tmp_path, town_stereo, ", workers=2")
    assert done.returncode == 1 and done.stdout == ""
    last = done.stderr.splitlines()[-1]
    assert "ToolError: a worker process ended" in last and 'if __name__ == "__main__":' in last
