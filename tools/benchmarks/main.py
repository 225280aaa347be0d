"""The whole pipeline on the embedded recording: speed, memory, recall, and reproducibility."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hickory_stream.evaluation.match import meshes_of, score_map
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.records import Phase
from tools.benchmarks.figures import Figure, Options
from tools.benchmarks.processes import ROOT, Played, play

_LOG = ROOT / "recordings" / "demo.mcap"
_TRUTH = ROOT / "recordings" / "demo.truth"
_LOOPS = 3


def measure(options: Options) -> list[Figure]:
    """Return the figures; a quick run leaves out the repetition and the loops."""
    figures = [_help_seconds()]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        first = play(_LOG, folder / "first", "--workers", "1", "--rrd", str(folder / "first.rrd"))
        figures += [*_of_the_run(first), *_of_the_map(folder / "first")]
        if not options.quick:
            second = play(_LOG, folder / "second", "--workers", "2")
            same = first.finished["digest"] == second.finished["digest"]
            figures.append(Figure(name="runs_identical", value=float(same), unit="", better="higher"))
            looped = play(_LOG, folder / "looped", "--loop", str(_LOOPS))
            figures.append(Figure(name="loop_growth_mb", value=_growth_mb(looped), unit="MB", better="lower"))
    return figures


def _help_seconds() -> Figure:
    seconds = []
    for _ in range(5):
        started = time.perf_counter()
        subprocess.run([sys.executable, "-m", "hickory_stream", "--help"], check=True, capture_output=True, cwd=ROOT)
        seconds.append(time.perf_counter() - started)
    return Figure(name="help_seconds", value=statistics.median(seconds), unit="s", better="lower")


def _of_the_run(played: Played) -> list[Figure]:
    frames = load_truth(_TRUTH).frames
    log_s = (frames[-1].stamp_ns - frames[0].stamp_ns) / 1e9
    return [
        Figure(name="demo_realtime_factor", value=log_s / played.seconds, unit="x", better="higher"),
        Figure(name="demo_peak_rss_mb", value=played.peak_mb, unit="MB", better="lower"),
    ]


def _of_the_map(folder: Path) -> list[Figure]:
    saved = open_map(folder)
    score = score_map(saved.snapshot, meshes_of(saved), load_truth(_TRUTH))
    objects = [tracked for tracked in saved.snapshot.objects if tracked.phase is not Phase.TENTATIVE]
    complete = all(
        o.shape is not None and len(o.shape.fitted) > 0 and o.shape.containment.is_certified for o in objects
    )
    return [
        Figure(name="demo_recall_25", value=score.recall_25, unit="", better="higher"),
        Figure(name="demo_tracks_per_object", value=score.tracks_per_object, unit="", better="lower"),
        Figure(name="demo_layers_complete", value=float(complete and bool(objects)), unit="", better="higher"),
    ]


def _growth_mb(looped: Played) -> float:
    """Return the mapper's own memory at the end of the last loop less that at the end of the first."""
    total = max(frames for frames, _ in looped.memory_by_frames)
    per_loop = total / _LOOPS

    def at_end_of(loop: int) -> float:
        low, high = (loop - 0.15) * per_loop, loop * per_loop
        return statistics.median(mb for frames, mb in looped.memory_by_frames if low <= frames <= high and mb > 0)

    return at_end_of(_LOOPS) - at_end_of(1)
