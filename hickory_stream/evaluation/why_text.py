"""Histories and reasons as text."""

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

from hickory_stream.evaluation.false_origins import FALSE_ORIGINS
from hickory_stream.evaluation.miss_reasons import MISS_REASONS
from hickory_stream.evaluation.why import ObjectStory, ReasonCount, Why
from hickory_stream.inspection.point_history import PlaceStory
from hickory_stream.inspection.track_history import Stretch, TrackStory

_WIDTH = 120


def why_text(why: Why) -> str:
    """Return the reasons of all missed true objects and the origins of all false objects."""
    lines = [missed_title(why), *_counted(why.reasons, len(why.missed), MISS_REASONS), ""]
    for item in why.missed:
        lines += [f"{item.kind}: {item.reason}", _indented(item.text)]
    lines += ["", false_title(why), *_counted(why.origins, len(why.false), FALSE_ORIGINS), ""]
    for found in why.false:
        lines += [f"#{found.map_id}: {found.origin}", _indented(found.text)]
    return "\n".join(lines).rstrip()


def missed_title(why: Why) -> str:
    """Return the counts of missed, counted and ignored true objects, and of those within reach."""
    aside = f"; {why.num_little_seen} more were seen too little to count" if why.num_little_seen else ""
    within = sum(item.reason != "out of reach" for item in why.missed)
    reach = f" ({within} of {why.num_reachable} that are reachable)"
    return f"{len(why.missed)} of {why.num_truth} true objects that count are missed{reach}{aside}"


def false_title(why: Why) -> str:
    """Return the counts of false, all and ignored objects."""
    aside = f"; {why.num_aside} more are of true objects that do not count" if why.num_aside else ""
    aside += f"; {why.num_structure} more are fixtures on structure" if why.num_structure else ""
    counted = why.num_objects - why.num_aside - why.num_structure
    return f"{len(why.false)} of {counted} objects are no true object{aside}"


def object_text(story: ObjectStory) -> str:
    """Return the history of one true object."""
    if story.missed is not None:
        answer = f"missed: {story.missed.reason} ({MISS_REASONS[story.missed.reason]})\n{_indented(story.missed.text)}"
    elif story.map_id is not None:
        kind = ", a fixture" if story.is_fixture else ""
        answer = f"found: it is #{story.map_id}{kind}, box IoU {story.iou:.2f}"
    else:
        answer = f"not counted: the log shows {story.seen_fraction:.0%} of its surface, 30 % would count"
    return "\n".join([f"{story.truth_id} {story.kind}: {answer}", *_history(story.tracks, story.stretches)])


def place_text(story: PlaceStory) -> str:
    """Return the history of a point."""
    lines = []
    if story.asked is not None:
        u, v = story.asked.pixel
        lines.append(f"pixel {u:g},{v:g} of frame {story.asked.frame}: {story.asked.text}")
    if story.point_m is not None:
        lines.append(f"at ({', '.join(f'{value:.2f}' for value in story.point_m)}) m: {story.verdict}")
    else:
        lines.append(story.verdict)
    floor = ["", "the floor:", *(f"  {change}" for change in story.floor_changes)] if story.floor_changes else []
    return "\n".join([*lines, *_history(story.tracks, story.stretches), *floor])


def _history(tracks: Sequence[TrackStory], stretches: Sequence[Stretch]) -> list[str]:
    lines = []
    if stretches:
        width = max(len(_frames(stretch)) for stretch in stretches)
        lines += ["", "frame by frame (keyframes):"]
        lines += [f"  {_frames(s):<{width}}  {s.num_keyframes:>3}  {s.text}" for s in stretches]
    if tracks:
        lines += ["", "its tracks:"]
        lines += [_track(track) for track in tracks]
    return lines


def _frames(stretch: Stretch) -> str:
    first, last = stretch.first_frame, stretch.last_frame
    return f"{first}" if first == last else f"{first}-{last}"


def _track(track: TrackStory) -> str:
    first = "at the end" if track.first_frame is None else f"in frame {track.first_frame}"
    end, s = track.ending or "in the map", "" if track.num_keyframes == 1 else "s"
    text = (
        f"#{track.id} made {first}: {track.born}",
        f"seen in {track.num_keyframes} keyframe{s}",
        *track.changes,
        end,
    )
    return _indented("; ".join(text))


def _counted(counts: Sequence[ReasonCount], total: int, meanings: Mapping[Any, str]) -> list[str]:
    width = max((len(item.reason) for item in counts), default=0)
    return [f"  {item.count:>3} of {total}  {item.reason:<{width}}  {meanings[item.reason]}" for item in counts]


def _indented(text: str) -> str:
    return fill(text, _WIDTH, initial_indent="    ", subsequent_indent="    ")
