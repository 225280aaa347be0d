"""Maps of apartments and table-tops against truth, and the speed."""
# A scene is a truth folder NAME.truth with its log NAME.mcap beside it; it is a table-top where the median diameter of
# its true objects that count is below 0.4 m, else an apartment. Pages with pictures go to out/quality/.

import html
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hickory_stream.base.html_page import page
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.evaluate import Evaluation, evaluate
from hickory_stream.evaluation.page import write_page
from hickory_stream.evaluation.truth import TRUTH_FILE, Truth, load_truth
from hickory_stream.map_folder.saved_map import open_map
from tools.benchmarks.common.baseline import QUICK
from tools.benchmarks.common.cached_runs import walk_recording
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import DEMO, ROOT, play
from tools.worlds.cache import cached_recording

_PAGES = ROOT / "out" / "quality"
_TABLETOP_M = 0.4
_APARTMENTS, _WALKS, _TABLETOPS = 4, 2, 3
_RATE_HZ, _FAST_HZ = 15.0, 30.0
_TWO = "two_"
_COLUMNS = {
    "recall": "recall_25", "precision": "precision_25", "recall .5": "recall_50", "tracks": "tracks_per_object",
    "F1 5 %": "f1_5pct", "ADD-S .1": "adds_10", "ADD-S .05": "adds_05", "contained": "containment",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class Scene:
    """A log and its truth; once played, the evaluation of its map, and the seconds of the log and of playing."""

    name: str
    log: Path
    truth: Truth
    evaluation: Evaluation | None = None
    wall_s: float = 0.0

    @property
    def log_s(self) -> float:
        return (self.truth.frames[-1].stamp_ns - self.truth.frames[0].stamp_ns) / 1e9

    @property
    def is_fast(self) -> bool:
        return self.log_s > 0 and (len(self.truth.frames) - 1) / self.log_s > 1.5 * _RATE_HZ

    @property
    def found(self) -> Evaluation:
        assert self.evaluation is not None
        return self.evaluation

    @property
    def is_tabletop(self) -> bool:
        return self.found.median_diameter_m < _TABLETOP_M

    def cells(self) -> list[float]:
        """Return the figures of the scene in the order of the page's columns."""
        return [getattr(self.found, name) or 0.0 for name in _COLUMNS.values()]


def measure(options: Options) -> list[Figure]:
    """Return the figures; a figure that was not measured is absent."""
    # A quick run plays the embedded recording alone, unless it is given scenes; `--only apartments` plays
    # one walk through each of two apartments. Their figures have names of their own.
    is_part = options.quick or bool(options.only)
    scenes = []
    with tempfile.TemporaryDirectory() as temporary:
        for scene in _scenes(options):
            scenes.append(_played(scene, Path(temporary) / "map", draws_page=not is_part))
            cells = ", ".join(f"{name} {value:.3f}" for name, value in zip(_COLUMNS, scenes[-1].cells(), strict=True))
            print(f"{scene.name}: {cells}; {scene.log_s:.0f} s of log in {scenes[-1].wall_s:.0f} s", flush=True)
    figures = _figures(scenes)
    if is_part:
        prefix = QUICK if options.quick else _TWO
        return [replace(one, name=prefix + one.name) for one in figures]
    _write_index(scenes)
    return figures


def _scenes(options: Options) -> list[Scene]:
    if options.scenes:
        return [_scene_at(folder) for given in options.scenes for folder in _truth_folders(given)]
    if options.quick:
        return [_scene_at(DEMO.with_suffix(".truth"))]
    base = 1001 + 10 * options.seed
    if options.only:
        configs = [walk_recording("apartment", base + i) for i in range(2)]
    else:
        configs = [walk_recording("apartment", base + i, walk) for i in range(_APARTMENTS) for walk in range(_WALKS)]
        configs += [walk_recording("tabletop", base + i) for i in range(_TABLETOPS)]
        # One log at full rate: the real-time factor is promised for it.
        configs.append(walk_recording("apartment", base, 0, _FAST_HZ))
    made = []
    for config in configs:
        print(f"recording {config.scene} {config.seed}, walk {config.walk_index}", flush=True)
        log, truth = cached_recording(config)
        made.append(Scene(name=log.stem, log=log, truth=truth))
    return made


def _truth_folders(given: Path) -> list[Path]:
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


def _played(scene: Scene, out: Path, *, draws_page: bool) -> Scene:
    wall_s = play(scene.log, out).seconds
    saved = open_map(out)
    evaluation = evaluate(saved, scene.truth)
    if draws_page:
        _PAGES.mkdir(parents=True, exist_ok=True)
        write_page(_PAGES / f"{scene.name}.html", saved, scene.truth, evaluation)
    return replace(scene, evaluation=evaluation, wall_s=wall_s)


def _figures(scenes: list[Scene]) -> list[Figure]:
    # The log at full rate repeats a scene: only its speed counts, unless it is the only one.
    counted = [scene for scene in scenes if not scene.is_fast] or scenes
    timed = [scene for scene in scenes if scene.is_fast] or scenes
    figures = [figure("scenes", len(counted))]
    for kind, names in (
        ("apartments", ("recall_25", "precision_25", "recall_50", "f1_5pct", "adds_10", "tracks_per_object")),
        ("tabletops", ("f1_5pct", "adds_05")),
    ):
        chosen = [scene.found for scene in counted if scene.is_tabletop is (kind == "tabletops")]
        for name in names if chosen else ():
            better = "lower" if name == "tracks_per_object" else "higher"
            figures.append(figure(f"{kind}_{name}", np.mean([getattr(one, name) for one in chosen]), "", better))
    contained = [scene.found.containment for scene in counted if scene.found.containment is not None]
    if contained:
        figures.append(figure("containment", np.mean(contained)))
    factor = sum(scene.log_s for scene in timed) / sum(scene.wall_s for scene in timed)
    return [*figures, figure("realtime_factor", factor, "x")]


def _write_index(scenes: list[Scene]) -> None:
    rows = "".join(
        f'<tr><td><a href="{html.escape(one.name)}.html">{html.escape(one.name)}</a></td>'
        f"<td>{'table-top' if one.is_tabletop else 'apartment'}</td>"
        f"{''.join(f'<td>{value:.3f}</td>' for value in one.cells())}</tr>"
        for one in scenes
    )
    head = "".join(f"<th>{name}</th>" for name in ("scene", "kind", *_COLUMNS))
    body = f"<h1>Quality by scene</h1><table><tr>{head}</tr>{rows}</table>"
    style = "td, th { padding: .2rem .8rem; text-align: right; } td:first-child, th:first-child { text-align: left; }"
    (_PAGES / "index.html").write_text(page("Quality by scene", body, style), encoding="utf-8")
