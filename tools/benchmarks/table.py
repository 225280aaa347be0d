"""The benchmarks by name: module and function, description, and the code that their figures depend on."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass

from tools.benchmarks.common.code_hashes import MAPS, PLAYERS, code_hash
from tools.benchmarks.common.figures import Figure, Options


@dataclass(frozen=True, slots=True)
class Benchmark:
    """A function `(Options) -> list[Figure]` of a module, and the code on which its figures depend."""

    # Figures of a run that is not quick depend on the code of `whole`, too.

    module: str
    about: str
    code: tuple[str, ...] = MAPS
    whole: tuple[str, ...] = ()
    function: str = "measure"

    @property
    def measure(self) -> Callable[[Options], list[Figure]]:
        """The function, imported on first use."""
        found: Callable[[Options], list[Figure]] = getattr(
            importlib.import_module(f"tools.benchmarks.{self.module}"), self.function
        )
        return found


_SHAPES = ("hickory_stream/geometry", "hickory_stream/shapes")
_ALIGNMENT = ("hickory_stream/geometry", "hickory_stream/alignment", "tools/evaluation/simulated_maps")
_MAP_FILES = ("hickory_stream/journal", "hickory_stream/map_folder")
_FLEETS = ("hickory_stream/alignment", "hickory_stream/fleet", "hickory_stream/merging")

BENCHMARKS = {
    "main": Benchmark("maps.demo", "the demo from end to end: speed, memory, recall, one digest"),
    "quality": Benchmark("maps.quality", "maps of synthetic worlds against truth"),
    "golden": Benchmark("maps.golden", "digests and figures of three small logs, as a gate"),
    "foreign": Benchmark("foreign.gate", "maps of rooms by others, a labelled kitchen, streets; oracle ablations"),
    "changes": Benchmark(
        "maps.changes", "differences between two days and within a run; passers-by; questions to a map",
        (*MAPS, "hickory_stream/alignment", "hickory_stream/changes", "hickory_stream/query"),
    ),
    "navigation": Benchmark(
        "maps.navigation", "occupancy and paths on boxes, meshes and layer 4", (*_SHAPES, "hickory_stream/navigation"),
        whole=MAPS,
    ),
    "perception": Benchmark("perception.frames", "masks of single frames, features, memory of layer 1"),
    "paper_masks": Benchmark(
        "perception.paper_masks", "maps with simulated networks, by error", (*MAPS, "tools/evaluation/masks")
    ),
    "rules": Benchmark(
        "perception.constants", "the count of numbers set by hand",
        ("hickory_stream/mapping", "hickory_stream/perception"),
    ),
    "shapes": Benchmark(
        "shapes.fitting", "fit, inflation and collision checks", (*_SHAPES, "hickory_stream/navigation/clearance.py")
    ),
    "layer2": Benchmark("shapes.generated", "placement, judgement and blending of generated shapes"),
    "align": Benchmark(
        "alignment.align", "alignment of simulated maps, look-alike places and apartments", _ALIGNMENT, whole=MAPS
    ),
    "poses": Benchmark(
        "poses.odometry", "odometry, drift, corridors, extrinsics, loops, pose graphs, fleets", (*MAPS, *_FLEETS)
    ),
    "players": Benchmark("logs.readers", "reading logs: speed, memory, containers, damage", PLAYERS),
    "doctor": Benchmark("logs.doctor_cases", "verdicts of doctor on sound logs and on faults put into them", PLAYERS),
    "damage": Benchmark("logs.damaged_logs", "damaged logs; altered maps with --maps", (*PLAYERS, *_MAP_FILES)),
    "live": Benchmark("live.robots", "robots over every live route: losses, latency, safety", MAPS),
    "engine": Benchmark("scale.engine", "determinism, kills, stops, live overload, hours of playback"),
    "scale": Benchmark("scale.scale", "large maps and alignments, real time by stage, a batch, a street"),
    "first_hour": Benchmark(
        "first_hour", "clone to picture, wheel to demo, set-up and tests, each with empty caches",
        (*MAPS, "requirements.lock"),
    ),
    "headline": Benchmark("headline", "the rows of the main README's table, in 45 minutes; continues where it stopped"),
}  # fmt: skip


def code_of(name: str, options: str = "") -> str:
    """Return the hash of the code that the figures of a benchmark depend on, run with these options."""
    one = BENCHMARKS[name]
    return code_hash(*one.code, *(() if "--quick" in options else one.whole))
