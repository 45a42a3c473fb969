"""Every attack against three presets: ``python tests/mas/hostile_table.py [PRESET ...]`` (``make hostile``). For each:
the others' mean error, and over that of the nearest run without hostility.

Not part of the tests, which play each attack where it does most: this takes minutes.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
import pytest
from test_hostile import ATTACKS, WITHIN, attacked, left, peaceful
from test_odd_agents import honest, without

from maslam.mas.evaluation.ground_truth import groups_of

PRESETS = ("maslam", "default", "selection")


def main(presets: list[str]) -> int:
    """Print a line an attack and preset; how many are beyond the bound of the tests, or leave honest agents apart."""
    kinds = dict.fromkeys((kind, odd) for _, odd, kind in ATTACKS)
    beyond = 0
    for name in presets or PRESETS:
        for kind, odd in kinds:
            with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
                environment, errors = attacked(patch, Path(folder) / "run", name, odd, kind)
            compared = max(np.mean(without(name, odd)), np.mean(peaceful(name, odd)), np.mean(left(name, odd)))
            joined = any(set(honest(odd)) <= set(group) for group in groups_of(environment.agents))
            ratio = np.mean(errors) / compared
            beyond += not joined or ratio > WITHIN
            apart = "" if joined else "  NOT in one frame"
            sys.stdout.write(f"{name:<10} {odd} {kind.__name__:<18} {np.mean(errors):.4f} m, {ratio:.3f}{apart}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{beyond} beyond {WITHIN}\n")
    return int(beyond > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
