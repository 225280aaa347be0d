"""The choice of views over many rooms: S against the paper's four strategies, with paired tests by room."""
# Apartments and table-tops of our generator, with seeds that nothing was tuned on, and the rooms by others for tuning.
# Each room's result is kept: a call that was stopped continues.

import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hickory_stream.config import MapperConfig
from hickory_stream.evaluation.surface_score import SurfaceScore
from hickory_stream.evaluation.truth import Truth, load_truth
from hickory_stream.shapes.build import make_reconstructor
from hickory_stream.sinks.disk_sink import DiskSink
from players import open_source
from tools.benchmarks.common.cached_runs import cached, state_folder
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.foreign.logs import foreign_log, worlds_folder
from tools.evaluation.views.comparison import compare, format_comparison
from tools.evaluation.views.trials import BEST, OURS, ViewTrial, try_views
from tools.worlds.cache import cached_recording
from tools.worlds.recording_config import RecordingConfig

_APARTMENTS, _TABLETOPS = range(7000, 7020), range(7000, 7030)
_FOREIGN = tuple((world, walk) for world in ("home", "bookstore") for walk in ("A", "B"))
_QUICK_TABLETOPS = 2


def view_figures(options: Options) -> list[Figure]:
    """Return the figures of the experiment, and print its table; no room begins after `minutes`."""
    folder = state_folder(options.state, "views")
    started, scenes = time.monotonic(), []
    for name, log, truth in _scenes(options):
        file = folder / f"{name}.json" if not options.quick else Path(tempfile.mkdtemp()) / "once.json"
        rows = cached(file, lambda log=log, truth=truth: {"trials": [*map(asdict, trials_of(log, truth))]})["trials"]
        scenes.append([_trial(row) for row in rows])
        print(f"{name}: {len(rows)} true objects", flush=True)
        if time.monotonic() - started > 60 * options.minutes:
            break
    scores = compare(scenes)
    print(format_comparison(scores), flush=True)
    other = next(score for score in scores if score.strategy not in (OURS, BEST))
    best, ours = (next(score for score in scores if score.strategy == name) for name in (BEST, OURS))
    paired, lost = other.s_minus_this, best.s_minus_this
    assert paired is not None and lost is not None, "only S itself is not compared with S"
    of = f"{ours.num_objects} objects of {ours.num_scenes} rooms, {ours.num_common} in the maps; F1 at 5 %, single_view"
    against = f"{of}; against {other.strategy}, {paired.low:+.4f}..{paired.high:+.4f}"
    against_best = f"{of}; against the best of the views that were tried, {lost.low:+.4f}..{lost.high:+.4f}"
    return [
        figure("views_s_minus_best_other", paired.mean, "", "higher", against),
        figure("views_p_value", paired.p_value, "", "lower", against),
        figure("views_objects", ours.num_objects, "", "higher", of),
        figure("views_s_minus_best_view", lost.mean, "", "higher", against_best),
    ]


def trials_of(log: Path, truth: Truth) -> list[ViewTrial]:
    config = MapperConfig()
    single = {"single_view": make_reconstructor("single_view", config.shapes)}
    source = open_source(str(log))
    with tempfile.TemporaryDirectory(prefix="hickory-views-") as temporary:
        try:
            return list(try_views(source, truth, config, single, Path(temporary) / "map", DiskSink)["single_view"])
        finally:
            source.close()


def _scenes(options: Options) -> Iterator[tuple[str, Path, Truth]]:
    if not options.quick:
        worlds = worlds_folder(options.worlds)
        for world, walk in _FOREIGN:
            found = foreign_log(worlds, world, walk, "hand")
            yield f"{world}-{walk}", found.log, load_truth(found.truth)
    own = [("tabletop", seed) for seed in _TABLETOPS[: _QUICK_TABLETOPS if options.quick else None]]
    own += [] if options.quick else [("apartment", seed) for seed in _APARTMENTS]
    # By seed, so that a part of them has rooms of both kinds.
    for scene, seed in sorted(own, key=lambda kind_seed: kind_seed[1]):
        seconds = 20.0 if scene == "tabletop" else 75.0
        yield f"{scene}-{seed}", *cached_recording(RecordingConfig(scene=scene, seed=seed, seconds=seconds))


def _trial(row: dict[str, Any]) -> ViewTrial:
    return ViewTrial(**{**row, "scores": {k: v and SurfaceScore(**v) for k, v in row["scores"].items()}})
