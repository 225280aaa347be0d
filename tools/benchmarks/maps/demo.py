"""The whole pipeline on the embedded recording: speed, memory, recall, and reproducibility."""

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
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import DEMO, ROOT, Played, play

_LOOPS = 3


def measure(options: Options) -> list[Figure]:
    """Return the figures; a quick run leaves out the repetition and the loops."""
    figures = [figure("help_seconds", statistics.median(_help_s() for _ in range(5)), "s", "lower")]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        first = play(DEMO, folder / "first", "--workers", "1", "--rrd", str(folder / "first.rrd"))
        figures += _of_demo(first, folder / "first")
        if not options.quick:
            second = play(DEMO, folder / "second", "--workers", "2")
            looped = play(DEMO, folder / "looped", "--loop", str(_LOOPS))
            figures += [
                figure("runs_identical", first.finished["digest"] == second.finished["digest"]),
                figure("loop_growth_mb", _growth_mb(looped), "MB", "lower"),
            ]
    return figures


def _help_s() -> float:
    started = time.perf_counter()
    subprocess.run([sys.executable, "-m", "hickory_stream", "--help"], check=True, capture_output=True, cwd=ROOT)
    return time.perf_counter() - started


def _of_demo(played: Played, folder: Path) -> list[Figure]:
    truth, saved = load_truth(DEMO.with_suffix(".truth")), open_map(folder)
    log_s = (truth.frames[-1].stamp_ns - truth.frames[0].stamp_ns) / 1e9
    score = score_map(saved.snapshot, meshes_of(saved), truth)
    shapes = [tracked.shape for tracked in saved.snapshot.objects if tracked.phase is not Phase.TENTATIVE]
    complete = bool(shapes) and all(one and len(one.fitted) and one.containment.is_certified for one in shapes)
    return [
        figure("demo_realtime_factor", log_s / played.seconds, "x", "higher"),
        figure("demo_peak_rss_mb", played.peak_mb, "MB", "lower"),
        figure("demo_recall_25", score.recall_25),
        figure("demo_tracks_per_object", score.tracks_per_object, "", "lower"),
        figure("demo_layers_complete", complete),
    ]


def _growth_mb(looped: Played) -> float:
    per_loop = max(frames for frames, _ in looped.memory_by_frames) / _LOOPS

    def at_end_of(loop: int) -> float:
        low, high = (loop - 0.15) * per_loop, loop * per_loop
        return statistics.median(mb for frames, mb in looped.memory_by_frames if low <= frames <= high and mb > 0)

    return at_end_of(_LOOPS) - at_end_of(1)
