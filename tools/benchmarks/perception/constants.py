"""The numbers that were set by hand in `perception` and `mapping`, and how many of them decide."""
# A number decides if another value of it can make another object of the same frames. The others are named in
# `NOT_DECIDING`, by the beginning of their name, with the reason.

import ast
import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hickory_stream.config import MapperConfig
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import ROOT

PACKAGES = ("perception", "mapping")
_TREES = "used when the trees were grown"
_NETWORK = "used when the network was trained"
_SHAPES, _SUBMAPS = "when shapes are computed", "in which submap an object is kept"
_WHOLE = "held or searched beyond what any check looks at"
NOT_DECIDING = {
    "perception.fastsam.": "of a network that is not installed by default",
    "perception.sam.": "of a network that is not installed by default",
    "perception/mask_evidence.py": "of a network that is not installed by default",
    "perception.network.": "how a network is run",
    "perception.dinov2.": "of a network that is not installed by default",
    "perception.semantic.": "of a network that is not installed by default",
    "mapping.requests.": _SHAPES, "mapping/track.py:_SKETCH_GROWTH": "when a sketch is drawn again",
    "mapping.submaps.": _SUBMAPS, "mapping/submaps.py:_DRIFT": _SUBMAPS,
    "mapping/submaps.py:LEAST_BESIDE_M": _WHOLE, "mapping/submaps.py:_MOST_BESIDE_M": _WHOLE,
    "mapping/track_table.py": _WHOLE, "mapping/derived.py:_KEEP_KEYFRAMES": "how long a cloud is not packed",
    "mapping/floor_warnings.py": "what people are warned of",
    "mapping/ageing.py:_REFUTED_SHARE": _SHAPES, "mapping/ageing.py:_MADE_UP": _SHAPES,
    "mapping/ageing.py:_INWARDS": _SHAPES, "mapping/ageing.py:_ROUNDING_NS": "equality but for rounding",
    "perception/descriptor.py": "appearance, for places and alignment",
    "perception/coarse.py": "for people who ask why", "perception/pixel_inputs.py": _NETWORK,
    "perception/pixel_network.py": _NETWORK, "perception/fragment_odds.py": _TREES,
    "perception/odds_features.py": _TREES, "perception/absolute_features.py": _TREES,
    "perception/region_extents.py": _TREES, "perception/region_graph.py": _TREES, "perception/contacts.py": _TREES,
    "perception/color_split.py:_OTSU_BINS": "the bins of a histogram",
    "perception/detection.py:_AZIMUTHS": "the bins of a histogram", "perception/space.py": "the layout of keys",
    "mapping/shape_requests.py": _SHAPES, "mapping/views.py:_SECTORS": "how many views are kept",
    "mapping/association.py:_TIE": "equality but for rounding",
    "mapping/observed_space.py:_MOST_VOTES": "the range of a byte",
    "mapping/track.py:_BOX_POINTS": "how many points are read",
    "mapping/support_relations.py:_SAMPLE": "how many points are read",
    "mapping/support_relations.py:_UNDER": _SHAPES, "mapping/support_relations.py:_SECTORS": _SHAPES,
    "mapping/support_relations.py:_LOWER_M": _SHAPES, "mapping/support_graph.py:_ON_FLOOR_M": _SHAPES,
}  # fmt: skip
"""The reason why a number decides nothing, by the beginning of its name."""
_LEAST = 1e-3


@dataclass(frozen=True, kw_only=True, slots=True)
class Constant:
    """A number: of the configuration (`mapping.split.min_apart_s`), or of a module (`mapping/merging.py:_MEET_M`)."""

    # A module is named by its package and file, without the folders between; `[i]` is the place in a tuple.

    name: str
    value: float

    @property
    def is_configured(self) -> bool:
        return ":" not in self.name

    @property
    def decides(self) -> bool:
        return not any(self.name.startswith(prefix) for prefix in NOT_DECIDING)


def measure(_options: Options) -> list[Figure]:
    every = [constant for constant in constants() if constant.decides]
    configured = sum(constant.is_configured for constant in every)
    inline = "numbers with a fraction within functions, which have no name"
    return [
        figure("num_constants", len(every), "numbers", "lower", "those of the configuration and of modules"),
        figure("num_constants_configured", configured, "numbers", "lower", "those of the configuration"),
        figure("num_constants_inline", len(inline_numbers()), "numbers", "lower", inline),
    ]


def constants() -> list[Constant]:
    """Return every number of the configuration and of the modules of the two packages, by name."""
    config = MapperConfig()
    found = [one for package in PACKAGES for one in _configured(getattr(config, package), package)]
    for name, tree in _modules():
        for attribute, value in _assigned(tree).items():
            several = value if isinstance(value, tuple) else (value,)
            found += [
                Constant(name=f"{name}:{attribute}{f'[{i}]' if isinstance(value, tuple) else ''}", value=item)
                for i, item in enumerate(several)
                if isinstance(item, int | float) and not isinstance(item, bool)
            ]
    return found


def inline_numbers() -> list[str]:
    """Return the numbers with a fraction in functions of the two packages: `mapping/cloud.py:395 0.9`."""
    # Whole numbers and halves are not counted, which mostly are indices, axes, or the halves of formulas; nor are those
    # so small that they only keep a division finite.
    found = []
    for name, tree in _modules():
        if not any(name.startswith(prefix) for prefix in NOT_DECIDING if ":" not in prefix):
            seen = {
                (node.lineno, node.col_offset): node.value
                for function in ast.walk(tree)
                if isinstance(function, ast.FunctionDef)
                for part in (*function.body, *function.args.defaults, *filter(None, function.args.kw_defaults))
                for node in ast.walk(part)
                if isinstance(node, ast.Constant) and _has_fraction(node.value)
            }
            found += [f"{name}:{line} {value:g}" for (line, _), value in sorted(seen.items())]
    return found


def _modules() -> Iterator[tuple[str, ast.Module]]:
    for package in PACKAGES:
        folder: Path = ROOT / "hickory_stream" / package
        for path in sorted(folder.rglob("*.py")):
            if "models" not in path.relative_to(folder).parts:
                yield f"{package}/{path.name}", ast.parse(path.read_text(encoding="utf-8"))


def _configured(config: Any, name: str) -> Iterator[Constant]:
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from _configured(value, f"{name}.{field.name}")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield Constant(name=f"{name}.{field.name}", value=value)


def _assigned(tree: ast.Module) -> dict[str, object]:
    found: dict[str, object] = {}
    for node in tree.body:
        if not isinstance(node, ast.Assign):
            continue
        try:
            value = ast.literal_eval(node.value)
        except ValueError:
            continue
        match node.targets[0]:
            case ast.Name(id=name):
                found[name] = value
            case ast.Tuple(elts=targets):
                names = [target.id for target in targets if isinstance(target, ast.Name)]
                found |= dict(zip(names, value, strict=True))
    return {name: value for name, value in found.items() if name.isupper()}


def _has_fraction(value: object) -> bool:
    return isinstance(value, float) and 2 * value != int(2 * value) and value > _LEAST
