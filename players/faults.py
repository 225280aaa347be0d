"""Fault injection into a source, from a seed."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hickory_stream.errors import InputError, RecordingError
from hickory_stream.ports import Source, SourceAround
from hickory_stream.records import Frame, RawFrame


def _without_depth(raw: RawFrame) -> Frame:
    frame = raw.decode()
    return replace(frame, depth_m=np.full_like(frame.depth_m, np.nan))


@dataclass(frozen=True, kw_only=True, slots=True)
class Faults:
    """The share of frames with each kind of fault."""

    drop: float = 0.0
    duplicate: float = 0.0
    #: A frame comes three frames later, with its own stamp.
    delay: float = 0.0
    #: Two neighbours change places.
    reorder: float = 0.0
    #: Decoding raises.
    corrupt: float = 0.0
    stall: float = 0.0
    #: A frame has the stamp of the one before.
    freeze: float = 0.0
    #: The pose is metres off for one frame.
    teleport: float = 0.0
    #: Depth has no return.
    blind: float = 0.0
    #: Half the size, once for all.
    shrink: float = 0.0
    #: Duration of a stalled frame.
    stall_s: float = 0.5

    def __post_init__(self) -> None:
        for name in FAULTS:
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"found {name}={getattr(self, name):g}, expected a share of the frames, 0 to 1")
        if not 0.0 <= self.stall_s < 3600.0:
            raise InputError(f"found stall_s={self.stall_s:g}, expected seconds")


FAULTS = ("drop", "duplicate", "delay", "reorder", "corrupt", "stall", "freeze", "teleport", "blind", "shrink")


def parse_faults(text: str) -> Faults:
    """Return the faults that a text such as `drop=0.1,teleport=0.02` names.

    Raises `InputError`: a name or a number in it is wrong.
    """
    values: dict[str, float] = {}
    for part in text.split(","):
        name, _, number = part.partition("=")
        try:
            values[name.strip()] = float(number)
        except ValueError as error:
            raise InputError(f"found {part!r} among the faults, expected NAME=SHARE such as drop=0.1") from error
    unknown = values.keys() - {*FAULTS, "stall_s"}
    if unknown:
        raise InputError(f"found the faults {', '.join(sorted(unknown))}, expected some of {', '.join(FAULTS)}")
    return Faults(**values)


class FaultySource(SourceAround):
    """A `Source` that plays another one with faults; the same seed gives the same faults at the same frames."""

    def __init__(self, source: Source, faults: Faults, seed: int = 0) -> None:
        super().__init__(source)
        self._faults = faults
        self._seed = seed
        self._injected: Counter[str] = Counter()

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames, some of them with faults; indices count what is yielded."""
        self._injected = Counter()
        for index, frame in enumerate(self._in_disorder()):
            yield replace(frame, index=index, decode=partial(_renumbered, frame.decode, index))

    def _in_disorder(self) -> Iterator[RawFrame]:
        held: list[tuple[int, RawFrame]] = []
        swapped: RawFrame | None = None
        for number, frame in enumerate(self._with_faults()):
            for due, late in [entry for entry in held if entry[0] <= number]:
                held.remove((due, late))
                yield late
            rng = np.random.default_rng([self._seed, 1, number])
            if self._happens("delay", rng):
                held.append((number + 3, frame))
            elif swapped is None and self._happens("reorder", rng):
                swapped = frame
            else:
                yield frame
                if swapped is not None:
                    yield swapped
                    swapped = None
        yield from ([swapped] if swapped is not None else [])
        yield from (frame for _, frame in held)

    def _with_faults(self) -> Iterator[RawFrame]:
        last_ns: int | None = None
        is_small = False
        for number, frame in enumerate(self._source.frames()):
            rng = np.random.default_rng([self._seed, 0, number])
            happens = {name: self._happens(name, rng) for name in FAULTS if name not in ("delay", "reorder")}
            if happens["stall"]:
                time.sleep(self._faults.stall_s)
            if happens["drop"]:
                continue
            is_small = is_small or happens["shrink"]
            changed = frame
            if happens["freeze"] and last_ns is not None:
                changed = replace(changed, stamp_ns=last_ns)
            last_ns = frame.stamp_ns
            if happens["teleport"]:
                pose = changed.world_from_camera.copy()
                pose[:3, 3] += rng.uniform(-5.0, 5.0, 3)
                changed = replace(changed, world_from_camera=pose)
            if changed is not frame:
                changed = replace(changed, decode=partial(_restamped, changed))
            if happens["blind"]:
                changed = replace(changed, decode=partial(_without_depth, changed))
            if is_small:
                camera = changed.camera.scaled(0.5)
                changed = replace(changed, camera=camera, color_bytes=None, decode=partial(_halved, changed))
            if happens["corrupt"]:
                changed = replace(changed, decode=partial(_torn, number))
            yield changed
            if happens["duplicate"]:
                yield changed

    def _happens(self, name: str, rng: np.random.Generator) -> bool:
        happens = bool(rng.random() < getattr(self._faults, name))
        self._injected[name] += happens
        return happens

    def ledger(self) -> Mapping[str, int]:
        """Return the ledger of the other source, and how often each fault was injected, as `injected_NAME`."""
        made = {f"injected_{name}": number for name, number in sorted(self._injected.items()) if number}
        return {**self._source.ledger(), **made}


def _renumbered(decode: Callable[[], Frame], index: int) -> Frame:
    return replace(decode(), index=index)


def _restamped(raw: RawFrame) -> Frame:
    return replace(raw.decode(), stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)


def _halved(raw: RawFrame) -> Frame:
    frame = raw.decode()
    camera = frame.camera.scaled(0.5)
    size = (slice(0, 2 * camera.height, 2), slice(0, 2 * camera.width, 2))
    return replace(frame, rgb=frame.rgb[size].copy(), depth_m=frame.depth_m[size].copy(), camera=camera)


def _torn(number: int) -> Frame:
    raise RecordingError(f"frame {number} is torn: a fault that was asked for")
