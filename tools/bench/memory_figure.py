"""The picture of ``maslam bench memory``: memory, the maps' contents and time over frames."""

from __future__ import annotations

from pathlib import Path

from ..common.figures import colour_of, dress, saved_figure
from .memory import MemoryReport


def draw_memory(report: MemoryReport, path: Path) -> None:
    """Three charts side by side; the kind of file by the name's ending."""
    samples = report.samples
    frames = [s.frame for s in samples]
    with saved_figure(path, (11.5, 3.4)) as figure:
        memory, held, spent = figure.subplots(1, 3)
        memory.plot(frames, [s.resident_mb for s in samples], color=colour_of(0), label="resident")
        memory.plot(frames, [s.resident_mb - s.map_mb for s in samples], color=colour_of(4), label="without the maps")
        memory.plot(frames, [s.map_mb for s in samples], color=colour_of(2), label="maps")
        memory.set_ylim(bottom=0)
        memory.legend()
        dress(memory, f"memory: {report.bytes_per_frame:.0f} bytes per frame excluding the maps", "frames", "MB")
        for k, name in enumerate(("points", "keyframes", "culled")):
            held.plot(frames, [max(1, getattr(s, name)) for s in samples], color=colour_of(k), label=name)
        held.set_yscale("log")
        held.legend()
        dress(held, "what the maps hold", "frames", "")
        spent.plot(frames, [s.cpu_ms for s in samples], color=colour_of(0))
        spent.set_ylim(bottom=0)
        dress(spent, f"processor time per frame: {report.ms_growth:.2f} x in the end", "frames", "ms")
