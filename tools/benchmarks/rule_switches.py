"""The special rules of perception and mapping, each with the way to switch it off (or on, where it is off by default).

A rule that no number switches off is a function, which is replaced by one that never decides.
"""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hickory_stream.mapping.rules.merging import Votes, points_on_others
from hickory_stream.mapping.rules.support_relations import is_inner_part
from tools.benchmarks.rule_constants import patched, with_number

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from hickory_stream.config import MapperConfig

Way = Literal["perceived", "prepared", "anew"]
"""What a map is made of when one thing is changed: events of a first run, prepared keyframes, or keyframes."""

_NEVER = 1_000_000


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rule:
    """A rule, and what switches it.

    `numbers` of the configuration by name, and `patches`: (module, attribute, what takes its place). `is_on` by
    default. `way`: its map is made of what was `perceived` once; or perception is done again, since the rule is one of
    it or tells it what is structure, with what the segmenter `prepared` of the frames, or `anew` altogether.
    """

    name: str
    package: Literal["perception", "mapping"]
    numbers: tuple[tuple[str, Any], ...] = ()
    patches: tuple[tuple[str, str, object], ...] = ()
    is_on: bool = True
    way: Way = "prepared"

    @contextmanager
    def switched(self, config: MapperConfig) -> Iterator[MapperConfig]:
        """Yield the configuration with which the rule is switched, while its functions are."""
        for name, value in self.numbers:
            config = with_number(config, name, value)
        with ExitStack() as stack:
            for module, attribute, value in self.patches:
                stack.enter_context(patched(module, attribute, value))
            yield config


def _always(value: object) -> Callable[..., object]:
    return lambda *_, **__: value


def _argument(i: int) -> Callable[..., Any]:
    return lambda *given, **_: given[i]


def _none_of(*given: Any, **_: object) -> Any:
    """Return that none of the first argument's rows or pixels are."""
    return np.zeros(np.asarray(given[0]).shape[:1], dtype=bool)


def _no_pixels(surface: Any, *_: object, **__: object) -> Any:
    return np.zeros(surface.depth_m.shape, dtype=bool)


def _all_pixels(depth: Any, inner: Any, *_: object) -> Any:
    return inner & (depth > 0)


def _inner_part_where_merged(*given: Any, was_one: bool = False, **told: Any) -> bool:
    return not was_one and is_inner_part(*given, **told)


def _inner_part_where_split(*given: Any, was_one: bool = False, **told: Any) -> bool:
    return was_one and is_inner_part(*given, was_one=True, **told)


def _whole(*given: Any) -> Any:
    foreign, covered = points_on_others(*given)
    return np.zeros_like(foreign), covered


def _relation(name: str, function: str) -> Rule:
    return _of_mapping(name, "support_relations", function, _always(False))


def _of_mapping(name: str, module: str, function: str, value: object, way: Way = "perceived") -> Rule:
    return Rule(name=name, package="mapping", patches=((f"mapping.{module}", function, value),), way=way)


def _number(name: str, *numbers: tuple[str, Any], way: Way | None = None) -> Rule:
    if numbers[0][0].startswith("perception"):
        return Rule(name=name, package="perception", numbers=numbers)
    return Rule(name=name, package="mapping", numbers=numbers, way=way or "perceived")


def _of_perception(name: str, module: str, function: str, value: object) -> Rule:
    return Rule(name=name, package="perception", patches=((f"perception.{module}", function, value),))


RULES = (
    # Which observation is which track.
    _number("a partial view belongs to the track it lies on", ("mapping.associate.min_lies_on", 1.0)),
    _of_mapping("a swollen observation is not the track", "associate", "is_oversized", _always(False)),
    _of_mapping("points on another track are left out", "track_merging", "points_on_others", _whole),
    # Two tracks that are one thing.
    _of_mapping("tracks that lie on one another are one", "track_merging", "share_near", _always(0.0)),
    _number("less so, if seen apart more often", ("mapping.merge.sure_share", 0.5)),
    _of_mapping("tracks seen together are one", "track_merging:VoteBook", "of", _always(Votes())),
    _number("even if apart as often, if together often", ("mapping.merge.sure_votes", _NEVER)),
    _relation("the foot of a seat", "is_on_foot"),
    _relation("a leg under its table", "is_leg"),
    _relation("a plant stands in its pot", "stands_in"),
    _of_mapping("a part inside, touching", "support_relations", "is_inner_part", _inner_part_where_split),
    _relation("a panel touches across a wider gap", "is_panel"),
    _relation("what rests on a surface is no part", "_stands_on"),
    _of_mapping("a thick leg is covered by a board", "support_relations", "_covered_share", _always(1.0)),
    _of_mapping("what floats free belongs to the nearest", "unsupported", "attachment_of", _always(None)),
    # One track that is two things.
    _number("a part seen apart is split off", ("mapping.split.min_apart", _NEVER)),
    _of_mapping("but no inner part", "support_relations", "is_inner_part", _inner_part_where_merged),
    _number("nor a rim or a board", ("mapping.split.min_size_m", 0.0)),
    _of_mapping(
        "what was split off is no leg or part again",
        "track:Track",
        "is_promoted",
        property(_always(False), _always(None)),  # type: ignore[arg-type]
    ),
    # Which points are its.
    _of_mapping("what one frame put there is noise", "cloud", "solid_part", _argument(0)),
    _of_mapping("a tail of such points goes", "cloud", "_MOST_TAIL", 0.0),
    _of_mapping("points in a wall are not the track's", "structure_checks", "points_in_wall", _always(None)),
    # Which tracks are structure, or nothing.
    _number(
        "too large",
        ("mapping.lifecycle.structure_m", 1000.0),
        ("mapping.lifecycle.structure_m3", 1e6),
        way="prepared",
    ),
    _of_mapping("a piece of a wall", "structure_checks", "_is_piece_of_wall", _always(False), "prepared"),
    _number("a lintel", ("mapping.lifecycle.lintel_foot_m", 100.0), way="prepared"),
    _of_mapping("flush with the wall", "observed_space", "is_flush", _always(False), "prepared"),
    _of_mapping("an edge of a wall", "observed_space", "is_edge", _always(False), "prepared"),
    _number("a piece of such structure", ("mapping.lifecycle.structure_share", 1.0)),
    _of_mapping("seen through", "structure_checks", "is_seen_through", _always(False)),
    _number(
        "a sighting from elsewhere counts more", ("mapping.existence.fresh", 1.0), ("mapping.existence.again", 1.0)
    ),
    _number("a small thing's sighting counts less", ("mapping.existence.least", 1.0)),
    # What of a frame is room.
    _of_perception("what the map has as structure", "room_structure", "_known_structure", _no_pixels),
    _of_perception("the ceiling", "structure", "_ceiling", _no_pixels),
    _of_perception("a wall with something behind it", "structure", "_is_high", _always(False)),
    _number("but no front of a cupboard", ("perception.geometric.structure.backing_m2", 1000.0)),
    _of_perception("a wall is tall", "structure", "_is_tall", _always(True)),
    _of_perception("raised patches are none", "raised_patches", "raised_patches", lambda _, s, *__: np.zeros_like(s)),
    # Pieces of a frame, and what of them is one mask.
    _of_perception("concave creases divide", "fragments", "concave_creases", _no_pixels),
    _of_perception(
        "support planes divide", "fragments", "support_labels", lambda s, *_, **__: _no_pixels(s).astype(np.int32)
    ),
    _of_perception("small fragments go to a neighbour", "fragments", "_grow_into", _argument(0)),
    _of_perception("two colours divide", "color_split", "split_by_color", _argument(0)),
    _of_perception("planes that go on behind join", "occlusion_bridging", "is_bridged", _none_of),
    _number("the network has a say in joins", ("perception.segmenter", "geometric")),
    _number("few pixels are no mask", ("perception.geometric.min_area_px", 1)),
    _number("nor what is within the noise", ("perception.geometric.min_side_sigmas", 0.0)),
    _number("nor a small one that is mostly hidden", ("perception.geometric.occluded_area_px", 0)),
    _number("nor a long one", ("perception.geometric.max_extent_m", 1000.0), ("perception.observe.max_box_m", 1000.0)),
    # Masks in space.
    _of_perception("rims of masks must agree", "observe", "_agreeing", _argument(1)),
    _of_perception("returns must have company", "observe", "_supported", _all_pixels),
    _of_perception("no voxel with a return is free", "space", "_unmark", _always(None)),
    Rule(
        name="flying pixels are none",
        package="perception",
        patches=(("perception.surface", "_without_flying_pixels", _argument(0)),),
        way="anew",
    ),
    # Off by default.
    Rule(
        name="the network divides fragments",
        package="perception",
        numbers=(("perception.affinities.split.odds_shift", 2.0),),
        is_on=False,
    ),
)
