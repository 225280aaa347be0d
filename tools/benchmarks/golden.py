"""Three small logs of three layouts, whose maps are to stay as they are: digests to the byte, figures coarsely.

A change that moves a digest on purpose moves the baseline with it: `tools/bench golden --set-baseline "why"`. Shapes
are coarse, so that all of it takes seconds; what shapes are worth is measured by other benchmarks.
"""

from __future__ import annotations

import asyncio
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.base.config_text import read_config
from hickory_stream.config import MapperConfig
from hickory_stream.engine.mapper import Mapper
from hickory_stream.evaluation.evaluate import evaluate
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.records import Phase
from players import open_source
from players.first_frames import FirstFrames
from tools.benchmarks.coarse_runs import COARSE
from tools.benchmarks.figures import Figure
from tools.benchmarks.intervals import wilson
from tools.benchmarks.processes import ROOT

if TYPE_CHECKING:
    from tools.benchmarks.figures import Options

_FOLDER = ROOT / "tests" / "golden" / "logs"
LOGS = {
    "demo": ((ROOT / "recordings" / "demo.mcap",), ROOT / "recordings" / "demo.truth", 24),
    "tabletop": ((_FOLDER / "tabletop.bag", _FOLDER / "tabletop_vio.bag"), _FOLDER / "tabletop.truth", None),
    "room": ((_FOLDER / "room.mcap",), _FOLDER / "room.truth", None),
}
"""The files of a log, its truth, and how many frames of it are played; None: all."""


def measure(options: Options) -> list[Figure]:
    """Return digest, recall, precision and the objects with all four layers of each log; nothing of it is drawn."""
    with tempfile.TemporaryDirectory() as folder:
        return [figure for name in options.only or LOGS for figure in figures_of(name, Path(folder) / name)]


def figures_of(name: str, out: Path) -> list[Figure]:
    """Return the figures of one of `LOGS`, mapped into the folder `out`."""
    files, truth, num_frames = LOGS[name]
    config = read_config(MapperConfig, None, tuple(override.removeprefix("mapper.") for override in COARSE))
    asyncio.run(_map(files, num_frames, config, out))
    saved = open_map(out)
    found = evaluate(saved, load_truth(truth))
    objects = [item for item in saved.snapshot.objects if item.phase is not Phase.TENTATIVE]
    counted = [item for item in objects if item.id not in found.ignored_ids]
    matched = {row.map_id for row in found.objects} - {None}
    complete = sum(item.shape is not None for item in objects)
    assert saved.manifest.digest is not None
    return [
        Figure(name=f"{name}_digest", value=saved.manifest.digest, unit="", better="same"),
        _share(f"{name}_recall_25", len(matched), len(found.objects), "true objects"),
        _share(f"{name}_precision_25", len(matched), len(counted), "objects"),
        _share(f"{name}_with_all_layers", complete, len(objects), "objects"),
    ]


async def _map(files: tuple[Path, ...], num_frames: int | None, config: MapperConfig, out: Path) -> None:
    source = open_source(files)
    if num_frames is not None:
        source = FirstFrames(source, num_frames)
    try:
        async with Mapper(config, out=out) as mapper:
            async for _ in mapper.run(source):
                pass
    finally:
        source.close()


def _share(name: str, count: int, total: int, what: str) -> Figure:
    share = count / max(total, 1)
    of = f"{count} of {total} {what}"
    return Figure(
        name=name, value=share, unit="", better="higher", of=of, interval=wilson(count, total), interval_by="Wilson"
    )
