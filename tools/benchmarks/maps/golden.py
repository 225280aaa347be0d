"""Three small logs of three layouts as a gate: the digests of their maps to the byte, figures coarsely."""
# A change that moves a digest on purpose moves the baseline with it: `tools/bench golden --set-baseline "why"`. Shapes
# are coarse, so that all of it takes seconds.

import tempfile
from pathlib import Path

from hickory_stream.base.config_text import read_config
from hickory_stream.config import MapperConfig
from hickory_stream.evaluation.evaluate import evaluate
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.records import Phase
from players import open_source
from players.first_frames import FirstFrames
from tools.benchmarks.common.cached_runs import play_into
from tools.benchmarks.common.figures import Figure, Options, figure, share
from tools.benchmarks.common.processes import COARSE, DEMO, ROOT

_FOLDER = ROOT / "tests" / "golden" / "logs"
LOGS = {
    "demo": ((DEMO,), DEMO.with_suffix(".truth"), 24),
    "tabletop": ((_FOLDER / "tabletop.bag", _FOLDER / "tabletop_vio.bag"), _FOLDER / "tabletop.truth", None),
    "room": ((_FOLDER / "room.mcap",), _FOLDER / "room.truth", None),
}
"""The files of a log, its truth, and how many frames of it are played; None: all."""


def measure(options: Options) -> list[Figure]:
    """Return digest, recall, precision and the share of objects with all four layers of each log."""
    with tempfile.TemporaryDirectory() as folder:
        return [one for name in options.only or LOGS for one in figures_of(name, Path(folder) / name)]


def figures_of(name: str, out: Path) -> list[Figure]:
    files, truth, num_frames = LOGS[name]
    source = open_source(files)
    source = source if num_frames is None else FirstFrames(source, num_frames)
    play_into(out, source, read_config(MapperConfig, None, COARSE))
    saved = open_map(out)
    found = evaluate(saved, load_truth(truth))
    objects = [item for item in saved.snapshot.objects if item.phase is not Phase.TENTATIVE]
    num_counted = sum(item.id not in found.ignored_ids for item in objects)
    num_matched = len({row.map_id for row in found.objects} - {None})
    complete = sum(item.shape is not None for item in objects)
    assert saved.manifest.digest is not None
    return [
        figure(f"{name}_digest", saved.manifest.digest, "", "same"),
        *share(f"{name}_recall_25", num_matched, len(found.objects), "true objects"),
        *share(f"{name}_precision_25", num_matched, num_counted, "objects"),
        *share(f"{name}_with_all_layers", complete, len(objects), "objects"),
    ]
