"""The origin of a false object: one of a closed list, with the masks and merges that led to it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from hickory_stream.evaluation.miss_reasons import Evidence, extents_text, lies_on_text
from hickory_stream.geometry.boxes import box_iou

FalseOrigin = Literal[
    "a piece of an object", "an object whose box is off", "several things in one", "structure", "nothing there"
]

FALSE_ORIGINS: dict[FalseOrigin, str] = {
    "a piece of an object": "it lies mostly on a true object that another object matches, or that is in pieces",
    "an object whose box is off": "it is the only object on a true one, but their boxes have an IoU under 0.25",
    "several things in one": "its points lie on several true objects or on structure, on none of them more than half",
    "structure": "most of its points lie on floor, walls or ceiling",
    "nothing there": "most of its points lie on no true surface: depth noise, or an object that the truth leaves out",
}

_HALF = 0.5


@dataclass(frozen=True, kw_only=True, slots=True)
class FalseObject:
    """A mapped object that counts as false; `truth_ids` are the true objects in the text."""

    map_id: int
    origin: FalseOrigin
    text: str
    truth_ids: tuple[int, ...]


def origin_of(
    map_id: int, owner: int | None, tracks_of: Mapping[int, tuple[int, ...]], evidence: Evidence
) -> FalseObject:
    """Return the origin of a false object.

    `owner` is the true object under most of its points; `tracks_of` are the objects mostly on each true object.
    """
    lies_on = evidence.overlap.lies_on[map_id]
    of = lies_on_text(lies_on, evidence.names)
    history = history_text(map_id, evidence)
    if owner is not None:
        true, found = evidence.overlap.true_boxes[owner], evidence.boxes[map_id]
        others = [i for i in tracks_of.get(owner, ()) if i != map_id]
        name = evidence.names[owner]
        if others:
            beside = ", ".join(f"#{i}" for i in others)
            text = f"of {name}, which {beside} lies on, too; {history}"
            return FalseObject(map_id=map_id, origin="a piece of an object", text=text, truth_ids=(owner,))
        text = f"IoU {box_iou(true, found):.2f} with {name}: {extents_text(true, found)}; {history}"
        return FalseObject(map_id=map_id, origin="an object whose box is off", text=text, truth_ids=(owner,))
    text = f"{of}; {history}"
    if lies_on.structure > _HALF:
        return FalseObject(map_id=map_id, origin="structure", text=text, truth_ids=())
    if lies_on.nothing > _HALF:
        return FalseObject(map_id=map_id, origin="nothing there", text=text, truth_ids=())
    ids = tuple(i for i, share in sorted(lies_on.things.items(), key=lambda kv: (-kv[1], kv[0])) if share >= 0.1)
    return FalseObject(map_id=map_id, origin="several things in one", text=text, truth_ids=ids)


def history_text(map_id: int, evidence: Evidence) -> str:
    """Return the history of an object: its first mask, the number of its masks, and what they showed."""
    history = evidence.sightings.histories.by_id.get(map_id)
    if history is None:
        return "the journal tells nothing of it"
    merged = [
        i
        for i, other in evidence.sightings.histories.by_id.items()
        if other.ending is not None and other.ending.into == map_id
    ]
    first = "at the end" if history.born.frame is None else f"in frame {history.born.frame}"
    with_merged = f", with #{', #'.join(map(str, merged))} merged into it" if merged else ""
    masks = f"masks in {len(history.frames)} keyframe{'' if len(history.frames) == 1 else 's'}"
    text = f"made {first} ({history.born.text.partition(': ')[0]}) of {masks}{with_merged}"
    shown = shown_text(map_id, evidence)
    return f"{text}; {shown}" if shown else text


def shown_text(map_id: int, evidence: Evidence) -> str:
    """Return which true objects the masks of an object, and of tracks merged into it, showed; "" if there are none."""
    counts: dict[int | None, int] = {}
    for track_id, pixels in evidence.sightings.masks_of.items():
        if evidence.sightings.histories.final(track_id) == map_id:
            for truth_id, px in pixels.items():
                counts[truth_id] = counts.get(truth_id, 0) + px
    total = sum(counts.values())
    if not total:
        return ""
    names = {i: "no object" if i is None else evidence.names[i] for i in counts}
    ordered = sorted(counts.items(), key=lambda kv: (-kv[1], names[kv[0]]))
    text = ", ".join(f"{px / total:.0%} {names[i]}" for i, px in ordered if px >= 0.05 * total)
    return f"its masks show {text}"
