"""The merged maps of a fleet: finished maps are aligned and merged as by `merge`, one map per frame.

The frame with the most robots becomes `fleet.map`, further ones with two or more robots `fleet-2.map` and so on.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

from hickory_stream.alignment.answer import Alignment, NoAlignment
from hickory_stream.alignment.object_map import ObjectMap, object_map
from hickory_stream.engine.merged_map import write_merged_map
from hickory_stream.errors import MapFolderError
from hickory_stream.fleet.joins import Frame
from hickory_stream.fleet.robots import FLEET
from hickory_stream.map_folder.saved_map import SavedMap, check_unaltered, open_map
from hickory_stream.merging.groups import Group, groups_of
from hickory_stream.merging.joining import JoiningConfig, aligned_to_join
from hickory_stream.merging.merge_maps import merge_aligned

Answers = Mapping[tuple[int, int], Alignment | NoAlignment]


@dataclass(frozen=True, kw_only=True, slots=True)
class MergedFrame:
    """The merged map of the robots in one frame; `num_united` objects are in several robots' maps."""

    path: Path
    names: tuple[str, ...]
    digest: str | None
    num_objects: int
    num_united: int

    def as_json(self, members: str) -> dict[str, Any]:
        """Return the map as JSON data; `members` is the key of the names."""
        named = {"map": str(self.path), members: list(self.names), "digest": self.digest}
        return named | {"objects": self.num_objects, "united": self.num_united}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Finished:
    """Alignments and merged maps of the finished maps."""

    maps: Mapping[str, SavedMap]
    #: of each two robots
    answers: Mapping[tuple[str, str], Alignment | NoAlignment]
    #: of all robots with a map
    frames: tuple[Frame, ...]
    #: of frames with two and more robots, the largest first
    merged: tuple[MergedFrame, ...]
    #: by robot, why a map cannot be read
    problems: Mapping[str, str]


def merged_path(out: Path, place: int, name: str = FLEET) -> Path:
    """Return the folder of a merged map; `place` is the index of its frame."""
    return out / (f"{name}.map" if place == 0 else f"{name}-{place + 1}.map")


def all_pairs(maps: Sequence[ObjectMap]) -> Iterable[tuple[int, int]]:
    """Return each two of several maps."""
    return combinations(range(len(maps)), 2)


def finish(
    folders: Mapping[str, Path],
    out: Path,
    *,
    overwrite: bool,
    tell: Callable[[str], None] = lambda text: None,
    choose: Callable[[Sequence[ObjectMap]], Iterable[tuple[int, int]]] = all_pairs,
    name: str = FLEET,
    joining: JoiningConfig | None = None,
) -> Finished:
    """Align and merge the maps of a fleet's robots in the order of `folders`; raises `MapFolderError` for a merged map.

    `choose` returns the pairs (a, b), a < b, to align, `joining` the required certainty; `name` is of the merged map.
    """
    maps, problems = _opened(folders)
    names = tuple(maps)
    objects = [object_map(saved.snapshot, saved.manifest.extractor) for saved in maps.values()]
    answers = {}
    for a, b in choose(objects):
        tell(f"aligning {names[a]} and {names[b]}")
        answers[a, b] = aligned_to_join(objects[a], objects[b], joining)
    groups = groups_of([saved.snapshot for saved in maps.values()], answers)
    joined = sorted((group for group in groups if len(group.members) > 1), key=lambda group: -len(group.members))
    merged = tuple(
        _merged(group, list(maps.values()), answers, names, merged_path(out, place, name), overwrite, tell)
        for place, group in enumerate(joined)
    )
    return Finished(
        maps=maps,
        answers={(names[a], names[b]): answer for (a, b), answer in answers.items()},
        frames=tuple(_frame(group, names) for group in groups),
        merged=merged,
        problems=problems,
    )


def why_alone(name: str, answers: Mapping[tuple[str, str], Alignment | NoAlignment]) -> str:
    """Return why a robot shares no frame: its alignment with each other robot."""
    parts = []
    for (a, b), answer in answers.items():
        if name in (a, b):
            other = b if name == a else a
            parts.append(
                f"the other robots' alignments contradict that with {other}"
                if isinstance(answer, Alignment)
                else f"{other}: {answer.refusal.value}, {answer.reason}"
            )
    return "; ".join(parts) if parts else "no other robot has a map"


def _opened(folders: Mapping[str, Path]) -> tuple[dict[str, SavedMap], dict[str, str]]:
    maps, problems = {}, {}
    for name, folder in folders.items():
        try:
            saved = open_map(folder, warns=False)
            check_unaltered(saved)
        except MapFolderError as error:
            problems[name] = str(error)
        else:
            maps[name] = saved
    return maps, problems


def _frame(group: Group, names: Sequence[str]) -> Frame:
    return Frame(
        names=tuple(names[i] for i in group.members),
        frame_from_robot=group.group_from_map,
        pairs=tuple((names[a], names[b]) for a, b in group.pairs),
    )


def _merged(
    group: Group,
    maps: Sequence[SavedMap],
    answers: Answers,
    names: Sequence[str],
    path: Path,
    overwrite: bool,
    tell: Callable[[str], None],
) -> MergedFrame:
    inputs = [maps[i] for i in group.members]
    place = {a: i for i, a in enumerate(group.members)}
    own = {(place[a], place[b]): answer for (a, b), answer in answers.items() if a in place and b in place}
    merged = merge_aligned([saved.snapshot for saved in inputs], own)
    manifest = write_merged_map(
        path,
        merged,
        inputs,
        overwrite=overwrite,
        progress=lambda done, total: tell(f"shapes rebuilt: {done} of {total}"),
    )
    return MergedFrame(
        path=path,
        names=tuple(names[i] for i in group.members),
        digest=manifest.digest,
        num_objects=len(merged.objects),
        num_united=sum(len(members) > 1 for members in merged.provenance.values()),
    )
