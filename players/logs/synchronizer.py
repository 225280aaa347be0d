"""Pairs of colour and depth by their stamps, one to one, within a tolerance, while the log streams by.

The oldest waiting image is paired with the nearest of the other stream, unless that one has a nearer partner.
Mutually nearest images are paired if streams lag at most `HORIZON_NS` and are at most `DISORDER_NS` out of order.
"""

from bisect import insort
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from operator import attrgetter
from statistics import median
from typing import Any, Literal

Stream = Literal["color", "depth"]

HORIZON_NS = 1_000_000_000
"""How long an item waits for a stream that has fallen silent: this bounds the memory of waiting items."""

DISORDER_NS = 100_000_000
"""How late an image may be within its own stream."""

FALLBACK_TOLERANCE_NS = 50_000_000
"""The tolerance if a stream is too short to estimate its period."""


@dataclass(frozen=True, slots=True)
class Stamped:
    """An image of either stream; `item` is the caller's own record of it."""

    stream: Stream
    stamp_ns: int
    item: Any = field(compare=False)


@dataclass(frozen=True, kw_only=True, slots=True)
class Pair:
    """A colour and a depth image that belong together; the stamp is the colour's."""

    stamp_ns: int
    depth_stamp_ns: int
    color: Any
    depth: Any


@dataclass(frozen=True, kw_only=True, slots=True)
class Leftover:
    """An image without a partner; `is_late`: it arrived after its neighbours had been decided."""

    stream: Stream
    stamp_ns: int
    item: Any
    is_late: bool = False


def default_tolerance_ns(color_stamps_ns: Sequence[int], depth_stamps_ns: Sequence[int]) -> int:
    """Return half the period of the slower stream; a period is the median step between stamps."""
    periods = [_period_ns(color_stamps_ns), _period_ns(depth_stamps_ns)]
    known = [period for period in periods if period is not None]
    return max(known) // 2 if known else FALLBACK_TOLERANCE_NS


def pair_nearest(images: Iterable[Stamped], tolerance_ns: int) -> Iterator[Pair | Leftover]:
    """Yield every image exactly once, in a pair or as a leftover; pairs come in the order of their colour stamps."""
    return (match for match in pair_arriving(images, tolerance_ns) if match is not None)


def pair_arriving(
    images: Iterable[Stamped | None], tolerance_ns: int, *, is_live: bool = False
) -> Iterator[Pair | Leftover | None]:
    """Yield the same as `pair_nearest`, for a stream of images with None in between, which is passed on.

    `is_live`: images of equal stamps are paired at once, or after the largest disorder of the streams so far.
    """
    waiting: dict[Stream, list[Stamped]] = {"color": [], "depth": []}
    newest_ns: dict[Stream, int] = {}
    passed_ns: dict[str, int] = {}
    horizon_ns = max(HORIZON_NS, 4 * tolerance_ns)
    disorder_ns = 0 if is_live else DISORDER_NS
    for image in images:
        if image is None:
            yield None
            continue
        if is_live:
            late_ns = newest_ns.get(image.stream, image.stamp_ns) - image.stamp_ns
            disorder_ns = min(DISORDER_NS, max(disorder_ns, late_ns))
        if image.stamp_ns < passed_ns.get(image.stream, image.stamp_ns):
            yield Leftover(stream=image.stream, stamp_ns=image.stamp_ns, item=image.item, is_late=True)
            continue
        insort(waiting[image.stream], image, key=attrgetter("stamp_ns"))
        newest_ns[image.stream] = max(image.stamp_ns, newest_ns.get(image.stream, image.stamp_ns))
        settled_ns = max(newest_ns.values()) - horizon_ns
        certain_ns = settled_ns
        if len(newest_ns) == 2:
            # A partner is at most one tolerance away, and a nearer partner of that one at most one more.
            settled_ns = max(settled_ns, min(newest_ns.values()) - 2 * tolerance_ns - disorder_ns)
            certain_ns = min(newest_ns.values()) - disorder_ns if is_live else settled_ns
        while (oldest := _oldest(waiting)) is not None and (
            oldest.stamp_ns < settled_ns or (oldest.stamp_ns <= certain_ns and _has_twin(waiting))
        ):
            match = _decide(oldest, waiting, tolerance_ns)
            ends_ns = {"color": oldest.stamp_ns, "depth": oldest.stamp_ns}
            if isinstance(match, Pair):
                ends_ns = {"color": match.stamp_ns, "depth": match.depth_stamp_ns}
            passed_ns = {stream: max(end_ns, passed_ns.get(stream, end_ns)) for stream, end_ns in ends_ns.items()}
            yield match
    while (oldest := _oldest(waiting)) is not None:
        yield _decide(oldest, waiting, tolerance_ns)


def pair_epochs(
    images: Iterable[tuple[int, Stamped | None]], tolerance_ns: int, *, is_live: bool = False
) -> Iterator[tuple[int, Pair | Leftover | None]]:
    """Yield the pairs of images that are given with their epoch; images before and after a jump in time are not paired.

    The two streams jump one after the other. An epoch ends when the second stream has jumped too, or `HORIZON_NS` after
    the first one. `is_live` and None are those of `pair_arriving`.
    """
    source = iter(images)
    held: deque[tuple[int, Stamped]] = deque()
    epoch, is_ended = 0, False
    while not is_ended or held:

        def of_this_epoch(epoch: int = epoch) -> Iterator[Stamped | None]:
            nonlocal is_ended
            early, held_streams = list(held), set()
            held.clear()
            for number, kept in early:
                if number <= epoch:
                    yield kept
                else:
                    held.append((number, kept))
                    held_streams.add(kept.stream)
            for number, image in source:
                if image is None or number <= epoch:
                    yield image
                    continue
                held.append((number, image))
                held_streams.add(image.stream)
                span_ns = image.stamp_ns - held[0][1].stamp_ns
                if len(held_streams) == 2 or not 0 <= span_ns <= HORIZON_NS:
                    return
            is_ended = True

        for match in pair_arriving(of_this_epoch(), tolerance_ns, is_live=is_live):
            yield epoch, match
        epoch = min((number for number, _ in held), default=epoch + 1)


def _has_twin(waiting: dict[Stream, list[Stamped]]) -> bool:
    color, depth = waiting["color"], waiting["depth"]
    return bool(color and depth) and color[0].stamp_ns == depth[0].stamp_ns


def _oldest(waiting: dict[Stream, list[Stamped]]) -> Stamped | None:
    return min((images[0] for images in waiting.values() if images), key=attrgetter("stamp_ns"), default=None)


def _decide(oldest: Stamped, waiting: dict[Stream, list[Stamped]], tolerance_ns: int) -> Pair | Leftover:
    own = waiting[oldest.stream]
    others = waiting["depth" if oldest.stream == "color" else "color"]
    own.pop(0)
    if others and _is_partner(oldest, others[0], own, tolerance_ns):
        partner = others.pop(0)
        color, depth = (oldest, partner) if oldest.stream == "color" else (partner, oldest)
        return Pair(stamp_ns=color.stamp_ns, depth_stamp_ns=depth.stamp_ns, color=color.item, depth=depth.item)
    return Leftover(stream=oldest.stream, stamp_ns=oldest.stamp_ns, item=oldest.item)


def _is_partner(oldest: Stamped, other: Stamped, rivals: list[Stamped], tolerance_ns: int) -> bool:
    distance_ns = other.stamp_ns - oldest.stamp_ns
    return distance_ns <= tolerance_ns and all(
        abs(rival.stamp_ns - other.stamp_ns) >= distance_ns
        for rival in rivals
        if rival.stamp_ns - other.stamp_ns < distance_ns
    )


def _period_ns(stamps_ns: Sequence[int]) -> int | None:
    steps = [after - before for before, after in pairwise(sorted(set(stamps_ns)))]
    return int(median(steps)) if steps else None
