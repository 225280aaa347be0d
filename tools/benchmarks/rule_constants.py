"""The numbers that were set by hand in `perception` and `mapping`: which decide, and how to change one.

A number is one that decides if another value of it can make another object of what was seen. What does not is named in
`NOT_DECIDING`, by its prefix, with the reason: the one place where that is said.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hickory_stream.base.ranges import ranges_of
from hickory_stream.config import MapperConfig
from tools.benchmarks.processes import ROOT

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

PACKAGES = ("perception", "mapping")

NOT_DECIDING = {
    "perception.fastsam.": "of a network that is not installed by default",
    "perception.masks.": "resolves the masks of that network alone",
    "perception.network.": "how a network is run",
    "perception.dinov2.": "of a network that is not installed by default",
    "perception.semantic.": "of a network that is not installed by default",
    "mapping.requests.": "when shapes are computed",
    "mapping.track.sketch_growth": "when a sketch is drawn anew",
    "mapping.submaps.": "in which submap an object is kept",
    "perception/models/": "of networks that are not installed by default",
    "perception/masks.py": "resolves the masks of such a network alone",
    "perception/descriptor.py": "appearance, for places and alignment",
    "perception/coarse.py": "for people who ask why",
    "perception/affinity/pixel_inputs.py": "what the network was trained with",
    "perception/affinity/pixel_network.py": "what the network was trained with",
    "perception/regions/fragment_odds.py": "what the trees were grown with",
    "perception/regions/odds_features.py": "what the trees were grown with",
    "perception/regions/absolute_features.py": "what the trees were grown with",
    "perception/regions/region_extents.py": "what the trees were grown with",
    "perception/regions/region_graph.py": "what the trees were grown with",
    "perception/regions/contacts.py": "what the trees were grown with",
    "perception/fragments/color_split.py:_OTSU_BINS": "the bins of a histogram",
    "perception/structure/detection.py:_AZIMUTHS": "the bins of a histogram",
    "perception/space.py": "the layout of keys",
    "mapping/rules/shape_requests.py": "when shapes are computed",
    "mapping/entities/views.py:_SECTORS": "how many views are kept",
    "mapping/entities/existence.py:_MOST_PLACES": "how much is stored",
    "mapping/rules/association.py:_ROUNDING": "keeps a product of floats from missing its limit",
    "mapping/rules/association.py:_TIE": "what is equal but for rounding",
    "mapping/rules/lifecycle.py:_ROUNDING": "keeps a sum of floats from missing its limit",
    "mapping/entities/observed_space.py:_HELD": "a mark",
    "mapping/entities/observed_space.py:_MOST_VOTES": "the range of a byte",
    "mapping/entities/track.py:_BOX_POINTS": "how many points are looked at",
    "mapping/rules/support_relations.py:_SAMPLE": "how many points are looked at",
}
"""Why a number decides nothing, by the beginning of its name."""


_LEAST = 1e-3


@dataclass(frozen=True, kw_only=True, slots=True)
class Constant:
    """A number: of the configuration (`mapping.merge.min_votes`), or of a module (`mapping/rules/merging.py:_MEET_M`).

    `index` is its place in a tuple, None where it is alone. `is_compiled`: it was compiled into a function, so that
    another value has no effect in this process.
    """

    name: str
    value: float
    index: int | None = None
    is_compiled: bool = False

    @property
    def key(self) -> str:
        """Its name, with its place in a tuple."""
        return self.name if self.index is None else f"{self.name}[{self.index}]"

    @property
    def is_configured(self) -> bool:
        """Whether it is of the configuration."""
        return ":" not in self.name

    @property
    def package(self) -> str:
        """`perception` or `mapping`."""
        return self.name.replace("/", ".").partition(".")[0]

    @property
    def decides(self) -> bool:
        """Whether another value can make another object."""
        return not any(self.name.startswith(prefix) for prefix in NOT_DECIDING)


def constants() -> list[Constant]:
    """Return every number of the configuration and of the modules of the two packages, by name."""
    config = MapperConfig()
    found = [c for package in PACKAGES for c in _configured(getattr(config, package), package)]
    for package in PACKAGES:
        folder = ROOT / "hickory_stream" / package
        found += [c for path in sorted(folder.rglob("*.py")) for c in _of_module(path, path.relative_to(folder.parent))]
    return found


def inline_numbers() -> list[str]:
    """Return where a function of the two packages has a number with a fraction of its own: `mapping/core.py:95 0.9`.

    Whole numbers and halves are not counted, which mostly are indices, axes, or the halves of formulas; nor is what is
    so small that it only keeps a division finite.
    """
    found = []
    for package in PACKAGES:
        folder = ROOT / "hickory_stream" / package
        for path in sorted(folder.rglob("*.py")):
            name = path.relative_to(folder.parent).as_posix()
            if any(name.startswith(prefix) for prefix in NOT_DECIDING if ":" not in prefix):
                continue
            functions = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if _is_function(node)]
            seen = {
                (node.lineno, node.col_offset): node.value
                for function in functions
                for part in (*function.body, *function.args.defaults, *filter(None, function.args.kw_defaults))
                for node in ast.walk(part)
                if isinstance(node, ast.Constant) and _has_fraction(node.value)
            }
            found += [f"{name}:{line} {value:g}" for (line, _), value in sorted(seen.items())]
    return found


def moved(constant: Constant, by: float) -> float:
    """Return a number changed by a share of itself: a whole number by one at least, and within its range."""
    if not isinstance(constant.value, int):
        value = constant.value * (1 + by)
    else:
        step = max(1, round(abs(constant.value * by)))
        value = constant.value + (step if by > 0 else -step)
    if not constant.is_configured:
        return value
    *path, last = constant.name.split(".")
    owner: Any = MapperConfig()
    for part in path:
        owner = getattr(owner, part)
    allowed = ranges_of(type(owner))[last]
    return type(constant.value)(min(max(value, allowed.low), allowed.high))


def with_number(config: MapperConfig, name: str, value: float) -> MapperConfig:
    """Return a configuration in which the number of a name (`mapping.merge.min_votes`) is another one."""

    def replaced(owner: Any, path: list[str]) -> Any:
        first, *rest = path
        new = value if not rest else replaced(getattr(owner, first), rest)
        return dataclasses.replace(owner, **{first: new})

    out: MapperConfig = replaced(config, name.split("."))
    return out


@contextmanager
def patched(module: str, attribute: str, value: object) -> Iterator[None]:
    """Have a module of the two packages, or a class (`module:Class`), with another attribute.

    What the module itself defines is another thing for whoever imported it, too.
    """
    name, _, kind = module.partition(":")
    holder: Any = importlib.import_module(f"hickory_stream.{name}")
    owner = getattr(holder, kind) if kind else holder
    before = getattr(owner, attribute)
    holders = [owner]
    if not kind and getattr(before, "__module__", holder.__name__) == holder.__name__:
        others = [m for n, m in sys.modules.items() if n.startswith("hickory_stream.") and m is not holder]
        holders += [m for m in others if vars(m).get(attribute) is before]
    for each in holders:
        setattr(each, attribute, value)
    try:
        yield
    finally:
        for each in holders:
            setattr(each, attribute, before)


@contextmanager
def with_constant(config: MapperConfig, constant: Constant, value: float) -> Iterator[MapperConfig]:
    """Yield the configuration, or have the module, with another value of a number."""
    if constant.is_configured:
        yield with_number(config, constant.name, value)
        return
    path, _, attribute = constant.name.partition(":")
    module = path.removesuffix(".py").replace("/", ".")
    new: Any = value
    if constant.index is not None:
        whole = getattr(importlib.import_module(f"hickory_stream.{module}"), attribute)
        new = tuple(value if i == constant.index else item for i, item in enumerate(whole))
    with patched(module, attribute, new):
        yield config


def _configured(config: Any, name: str) -> Iterator[Constant]:
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from _configured(value, f"{name}.{field.name}")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield Constant(name=f"{name}.{field.name}", value=value)


def _of_module(path: Path, name: Path) -> Iterator[Constant]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    compiled = {
        node.id
        for function in ast.walk(tree)
        if _is_function(function) and any("kernel" in ast.unparse(d) for d in function.decorator_list)
        for node in ast.walk(function)
        if isinstance(node, ast.Name)
    }
    for attribute, value in _assigned(tree).items():
        told = f"{name.as_posix()}:{attribute}"
        several = enumerate(value) if isinstance(value, tuple) else [(None, value)]
        for index, item in several:
            if isinstance(item, int | float) and not isinstance(item, bool):
                yield Constant(name=told, value=item, index=index, is_compiled=attribute in compiled)


def _assigned(tree: ast.Module) -> Mapping[str, object]:
    """Return the names that a module gives to numbers and to tuples of them."""
    found: dict[str, object] = {}
    for node in tree.body:
        if not isinstance(node, ast.Assign):
            continue
        try:
            value = ast.literal_eval(node.value)
        except ValueError:
            continue
        target = node.targets[0]
        if isinstance(target, ast.Name):
            found[target.id] = value
        elif isinstance(target, ast.Tuple):
            names = [item.id for item in target.elts if isinstance(item, ast.Name)]
            found |= dict(zip(names, value, strict=True))
    return {name: value for name, value in found.items() if name.isupper()}


def _is_function(node: ast.AST) -> Any:
    return isinstance(node, ast.FunctionDef)


def _has_fraction(value: object) -> bool:
    return isinstance(value, float) and 2 * value != int(2 * value) and value > _LEAST
