"""How good maps are: apartments and table-tops against truth, the choice of views, and the speed.

A scene is a truth folder NAME.truth with its log NAME.mcap beside it; it is a table-top where the median diameter of
its true objects that count is below 0.4 m, else an apartment. Pages with pictures go to out/quality/.
"""

from __future__ import annotations

import html
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.base.html_page import page
from hickory_stream.config import MapperConfig
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.evaluate import evaluate
from hickory_stream.evaluation.page import write_page
from hickory_stream.evaluation.truth import TRUTH_FILE, load_truth
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.shapes.build import make_reconstructor
from hickory_stream.sinks.disk_sink import DiskSink
from players import open_source
from tools.benchmarks.baseline import QUICK
from tools.benchmarks.figures import Figure, Options
from tools.benchmarks.processes import ROOT, play
from tools.evaluation.views.comparison import compare, verdict
from tools.evaluation.views.trials import BEST, OURS, try_views
from tools.worlds.cache import cached_recording
from tools.worlds.recording_config import RecordingConfig

if TYPE_CHECKING:
    from hickory_stream.evaluation.evaluate import Evaluation
    from hickory_stream.evaluation.truth import Truth

_PAGES = ROOT / "out" / "quality"
_TABLETOP_M = 0.4
_APARTMENTS, _WALKS, _TABLETOPS = 4, 2, 3
_RATE_HZ, _FAST_HZ = 15.0, 30.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Scene:
    """A log and its truth."""

    name: str
    log: Path
    truth: Truth


@dataclass(frozen=True, kw_only=True, slots=True)
class Measured:
    """A scene after its log was played: `log_s` seconds of log took `wall_s`."""

    scene: Scene
    evaluation: Evaluation
    log_s: float
    wall_s: float

    @property
    def is_tabletop(self) -> bool:
        """Whether the scene's things are small."""
        return self.evaluation.median_diameter_m < _TABLETOP_M


def measure(options: Options) -> list[Figure]:
    """Return the figures; a figure that was not measured is absent.

    A quick run plays the embedded recording alone, unless it is given scenes, and compares no strategies.
    """
    scenes = _scenes(options)
    measured = []
    with tempfile.TemporaryDirectory() as temporary:
        for scene in scenes:
            measured.append(_measured(scene, Path(temporary) / "map", draws_page=not options.quick))
            print(_line(measured[-1]), flush=True)
        figures = _figures(measured)
        if not options.quick:
            _write_index(measured)
            figures += _of_strategies(_for_strategies(measured), Path(temporary))
    # Another sample than that of a whole run, and no smaller part of it: its figures have names of their own.
    return [replace(figure, name=QUICK + figure.name) for figure in figures] if options.quick else figures


def _scenes(options: Options) -> list[Scene]:
    if options.scenes:
        return [_scene_at(folder) for given in options.scenes for folder in _truth_folders(given)]
    if options.quick:
        return [_scene_at(ROOT / "recordings" / "demo.truth")]
    base = 1001 + 10 * options.seed
    configs = [_config("apartment", base + i, walk) for i in range(_APARTMENTS) for walk in range(_WALKS)]
    configs += [_config("tabletop", base + i, 0) for i in range(_TABLETOPS)]
    # One log at full rate: what the real-time factor is promised for.
    configs.append(_config("apartment", base, 0, _FAST_HZ))
    made = []
    for config in configs:
        print(f"recording {config.scene} {config.seed}, walk {config.walk_index}", flush=True)
        log, truth = cached_recording(config)
        made.append(Scene(name=log.stem, log=log, truth=truth))
    return made


def _config(scene: str, seed: int, walk_index: int, rate_hz: float = _RATE_HZ) -> RecordingConfig:
    return RecordingConfig(
        scene=scene, seed=seed, walk_index=walk_index, seconds=None, rate_hz=rate_hz, width=640, height=480
    )


def _truth_folders(given: Path) -> list[Path]:
    """Return a truth folder itself, or the truth folders inside a folder."""
    if (given / TRUTH_FILE).is_file():
        return [given]
    inside = sorted(path.parent for path in given.glob(f"*/{TRUTH_FILE}"))
    if not inside:
        raise RecordingError(f"{given} holds no {TRUTH_FILE}, and no folder in it does; name a truth folder")
    return inside


def _scene_at(folder: Path) -> Scene:
    folder = folder.resolve()
    logs = [path for path in sorted(folder.parent.glob(f"{folder.stem}.*")) if path.suffix not in (".truth", "")]
    if not logs:
        raise RecordingError(f"{folder} has no log beside it; expected {folder.stem}.mcap or another log of that name")
    return Scene(name=folder.stem, log=logs[0], truth=load_truth(folder))


def _measured(scene: Scene, out: Path, *, draws_page: bool) -> Measured:
    played = play(scene.log, out)
    saved = open_map(out)
    evaluation = evaluate(saved, scene.truth)
    if draws_page:
        _PAGES.mkdir(parents=True, exist_ok=True)
        write_page(_PAGES / f"{scene.name}.html", saved, scene.truth, evaluation)
    frames = scene.truth.frames
    log_s = (frames[-1].stamp_ns - frames[0].stamp_ns) / 1e9
    return Measured(scene=scene, evaluation=evaluation, log_s=log_s, wall_s=played.seconds)


def _figures(measured: list[Measured]) -> list[Figure]:
    is_fast = [_rate_hz(m) > 1.5 * _RATE_HZ for m in measured]
    # The log at full rate repeats a scene: it is there for its speed alone, unless it is all there is.
    counted = [m for m, fast in zip(measured, is_fast, strict=True) if not fast] or measured
    timed = [m for m, fast in zip(measured, is_fast, strict=True) if fast] or measured
    figures = [_figure("scenes", len(counted), "", "higher")]
    apartments = [m.evaluation for m in counted if not m.is_tabletop]
    tabletops = [m.evaluation for m in counted if m.is_tabletop]
    if apartments:
        for name in ("recall_25", "precision_25", "recall_50", "f1_5pct", "adds_10"):
            mean = float(np.mean([getattr(e, name) for e in apartments]))
            figures.append(_figure(f"apartments_{name}", mean, "", "higher"))
        tracks = float(np.mean([e.tracks_per_object for e in apartments]))
        figures.append(_figure("apartments_tracks_per_object", tracks, "", "lower"))
    if tabletops:
        for name in ("f1_5pct", "adds_05"):
            mean = float(np.mean([getattr(e, name) for e in tabletops]))
            figures.append(_figure(f"tabletops_{name}", mean, "", "higher"))
    contained = [m.evaluation.containment for m in counted if m.evaluation.containment is not None]
    if contained:
        figures.append(_figure("containment", float(np.mean(contained)), "", "higher"))
    factor = sum(m.log_s for m in timed) / sum(m.wall_s for m in timed)
    return [*figures, _figure("realtime_factor", factor, "x", "higher")]


def _rate_hz(measured: Measured) -> float:
    return (len(measured.scene.truth.frames) - 1) / measured.log_s if measured.log_s > 0 else 0.0


def _for_strategies(measured: list[Measured]) -> list[Scene]:
    """Return one apartment and one table-top, where there are both: each is played once more."""
    chosen = [next((m.scene for m in measured if m.is_tabletop is kind), None) for kind in (False, True)]
    return [scene for scene in chosen if scene is not None]


def _of_strategies(scenes: list[Scene], folder: Path) -> list[Figure]:
    single = {"single_view": make_reconstructor("single_view", MapperConfig().shapes)}
    trials = []
    for scene in scenes:
        print(f"views of {scene.name}", flush=True)
        source = open_source(str(scene.log))
        try:
            trials.append(
                try_views(source, scene.truth, MapperConfig(), single, folder / "views", DiskSink)["single_view"]
            )
        finally:
            source.close()
    scores = compare(trials)
    print(verdict(scores))
    others = [score for score in scores if score.strategy not in (OURS, BEST)]
    ours = next(score for score in scores if score.strategy == OURS)
    return [
        _figure("s_beats_baselines", float(all(score.f1_5pct < ours.f1_5pct for score in others)), "", "higher"),
        *(_figure(f"f1_by_strategy_{score.strategy}", score.f1_5pct, "", "higher") for score in (ours, *others)),
    ]


def _figure(name: str, value: float, unit: str, better: str) -> Figure:
    return Figure(name=name, value=float(value), unit=unit, better="lower" if better == "lower" else "higher")


def _line(measured: Measured) -> str:
    e = measured.evaluation
    return (
        f"{measured.scene.name}: recall {e.recall_25:.3f} / {e.recall_50:.3f}, precision {e.precision_25:.3f}, "
        f"tracks {e.tracks_per_object:.3f}, F1 {e.f1_5pct:.3f}, ADD-S {e.adds_10:.3f} / {e.adds_05:.3f}, "
        f"{measured.log_s:.0f} s of log in {measured.wall_s:.0f} s"
    )


def _write_index(measured: list[Measured]) -> None:
    rows = "".join(
        f'<tr><td><a href="{html.escape(m.scene.name)}.html">{html.escape(m.scene.name)}</a></td>'
        f"<td>{'table-top' if m.is_tabletop else 'apartment'}</td>"
        + "".join(
            f"<td>{value:.3f}</td>"
            for value in (
                m.evaluation.recall_25,
                m.evaluation.precision_25,
                m.evaluation.recall_50,
                m.evaluation.tracks_per_object,
                m.evaluation.f1_5pct,
                m.evaluation.adds_10,
                m.evaluation.adds_05,
                m.evaluation.containment or 0.0,
            )
        )
        + "</tr>"
        for m in measured
    )
    heads = (
        "scene",
        "kind",
        "recall",
        "precision",
        "recall .5",
        "tracks",
        "F1 5 %",
        "ADD-S .1",
        "ADD-S .05",
        "contained",
    )
    head = "".join(f"<th>{name}</th>" for name in heads)
    body = f"<h1>Quality by scene</h1><table><tr>{head}</tr>{rows}</table>"
    style = "td, th { padding: .2rem .8rem; text-align: right; } td:first-child, th:first-child { text-align: left; }"
    (_PAGES / "index.html").write_text(page("Quality by scene", body, style), encoding="utf-8")
