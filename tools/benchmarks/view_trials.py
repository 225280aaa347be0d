"""The experiment on views over many rooms: S against the paper's four strategies, with paired tests by room.

Apartments and table-tops of our generator, whose seeds nothing was chosen on, and the rooms of others that may be tuned
on. What a room gave is kept, so that a call that was stopped goes on where it was.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.config import MapperConfig
from hickory_stream.evaluation.surface_score import SurfaceScore
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.shapes.build import make_reconstructor
from hickory_stream.sinks.disk_sink import DiskSink
from players import open_source
from tools.benchmarks.figures import Figure
from tools.benchmarks.foreign_logs import foreign_log, worlds_folder
from tools.benchmarks.kept import kept, state_folder
from tools.evaluation.views.comparison import compare, format_comparison
from tools.evaluation.views.trials import BEST, OURS, ViewTrial, try_views
from tools.worlds.cache import cached_recording
from tools.worlds.recording_config import RecordingConfig

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from hickory_stream.evaluation.truth import Truth
    from tools.benchmarks.figures import Options

_APARTMENTS, _TABLETOPS = range(7000, 7020), range(7000, 7030)
_FOREIGN = tuple((world, walk) for world in ("home", "bookstore") for walk in ("A", "B"))
_QUICK_TABLETOPS = 2
_CODE = ("tools/benchmarks/view_trials.py",)


def view_figures(options: Options) -> list[Figure]:
    """Return the figures of the experiment, and print its table; no room is begun after `minutes`."""
    folder = state_folder(options.state, "views", *_CODE)
    started, scenes = time.monotonic(), []
    for name, log, truth in _scenes(options):
        file = folder / f"{name}.json" if not options.quick else Path(tempfile.mkdtemp()) / "once.json"
        scenes.append(_trials_of(kept(file, lambda log=log, truth=truth: _tried(log, truth))))
        print(f"{name}: {len(scenes[-1])} true objects", flush=True)
        if time.monotonic() - started > 60 * options.minutes:
            break
    return _figures(scenes)


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
        log, truth = cached_recording(RecordingConfig(scene=scene, seed=seed, seconds=seconds))
        yield f"{scene}-{seed}", log, truth


def _tried(log: Path, truth: Truth) -> dict[str, Any]:
    config = MapperConfig()
    single = {"single_view": make_reconstructor("single_view", config.shapes)}
    source = open_source(str(log))
    with tempfile.TemporaryDirectory(prefix="hickory-views-") as temporary:
        try:
            found = try_views(source, truth, config, single, Path(temporary) / "map", DiskSink)
        finally:
            source.close()
    return {"trials": [asdict(trial) for trial in found["single_view"]]}


def _trials_of(kept_trials: dict[str, Any]) -> tuple[ViewTrial, ...]:
    return tuple(
        ViewTrial(**{**row, "scores": {k: v and SurfaceScore(**v) for k, v in row["scores"].items()}})
        for row in kept_trials["trials"]
    )


def _figures(scenes: Sequence[Sequence[ViewTrial]]) -> list[Figure]:
    scores = compare(scenes)
    print(format_comparison(scores), flush=True)
    other = next(score for score in scores if score.strategy not in (OURS, BEST))
    best = next(score for score in scores if score.strategy == BEST)
    ours = next(score for score in scores if score.strategy == OURS)
    paired, lost = other.s_minus_this, best.s_minus_this
    assert paired is not None and lost is not None, "only S itself is not compared with S"
    of = f"{ours.num_objects} objects of {ours.num_scenes} rooms, {ours.num_common} in the maps; F1 at 5 %, single_view"
    told = f"{of}; against {other.strategy}, {paired.low:+.4f}..{paired.high:+.4f}"
    return [
        Figure(name="views_s_minus_best_other", value=paired.mean, unit="", better="higher", of=told),
        Figure(name="views_p_value", value=paired.p_value, unit="", better="lower", of=told),
        Figure(name="views_objects", value=ours.num_objects, unit="", better="higher", of=of),
        Figure(
            name="views_s_minus_best_view", value=lost.mean, unit="", better="higher",
            of=f"{of}; against the best of the views that were tried, {lost.low:+.4f}..{lost.high:+.4f}",
        ),
    ]  # fmt: skip
