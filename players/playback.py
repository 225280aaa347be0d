"""The playback clock, and a source that follows it: rate, pause, step, seek, from any thread.

`PlaybackClock.due_in_s` alone decides how long to wait; tests replace the function of the time.
"""

import threading
import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import InputError
from hickory_stream.geometry.rigid import both_jumps
from hickory_stream.mapping.rules.keyframes import Keyframe, KeyframeConfig, is_keyframe
from hickory_stream.ports import Source, SourceAround
from hickory_stream.records import Frame, RawFrame, SourceInfo

Step = Literal["frame", "keyframe"]


class PlaybackClock:
    """When frames are due. `rate` 1.0 is real time, None as fast as possible; all methods are thread-safe."""

    def __init__(self, rate: float | None = None, now_s: Callable[[], float] = time.monotonic) -> None:
        self._changed = threading.Condition()
        self._now_s = now_s
        self.rate = rate
        self.is_paused = False
        self._steps: dict[Step, int] = {"frame": 0, "keyframe": 0}
        self._origin: tuple[int, float] | None = None
        self._seek_ns: int | None = None
        self._is_stopped = False
        self.position_ns = 0
        self.first_ns: int | None = None

    def set_rate(self, rate: float | None) -> None:
        """Play at another rate from here on."""
        with self._changed:
            self.rate, self._origin = rate, None
            self._changed.notify_all()

    def pause(self, paused: bool | None = None) -> None:
        """Pause (True), continue (False), or toggle (None)."""
        with self._changed:
            self.is_paused = not self.is_paused if paused is None else paused
            self._origin = None
            self._changed.notify_all()

    def step(self, to: Step = "frame") -> None:
        """Pause, and let one more frame through, or all up to the next keyframe."""
        with self._changed:
            self.is_paused = True
            self._steps[to] += 1
            self._changed.notify_all()

    def seek(self, seconds: float, *, relative: bool = False) -> None:
        """Seek to a time of the log, in seconds from its beginning or from the current time."""
        with self._changed:
            origin_ns = self.position_ns if relative else (self.first_ns or 0)
            self._seek_ns = max(origin_ns + round(seconds * 1e9), self.first_ns or 0)
            self._origin = None
            self._changed.notify_all()

    def stop(self) -> None:
        """Let all frames pass without waiting, so that waiting threads end."""
        with self._changed:
            self._is_stopped = True
            self._changed.notify_all()

    def take_seek(self) -> int | None:
        """Return the requested position, once; None if no request is pending."""
        with self._changed:
            target, self._seek_ns = self._seek_ns, None
            return target

    def due_in_s(self, stamp_ns: int, *, is_keyframe: bool) -> float | None:
        """Return the seconds until a frame is due (0: now), None while playback is paused.

        A pending step is consumed by this frame.
        """
        if self._is_stopped or self._seek_ns is not None:
            return 0.0
        if self.is_paused:
            if self._steps["frame"]:
                self._steps["frame"] -= 1
                return 0.0
            if self._steps["keyframe"]:
                self._steps["keyframe"] -= is_keyframe
                return 0.0
            return None
        if self.rate is None:
            return 0.0
        now_s = self._now_s()
        if self._origin is None or stamp_ns < self._origin[0]:
            self._origin = (stamp_ns, now_s)
        return max(0.0, self._origin[1] + (stamp_ns - self._origin[0]) / 1e9 / self.rate - now_s)

    def wait(self, stamp_ns: int, *, is_keyframe: bool = False) -> None:
        """Return when a frame is due."""
        with self._changed:
            self.first_ns = stamp_ns if self.first_ns is None else min(self.first_ns, stamp_ns)
            while (left_s := self.due_in_s(stamp_ns, is_keyframe=is_keyframe)) != 0.0:
                self._changed.wait(left_s)
            self.position_ns = stamp_ns

    def describe(self) -> str:
        """Return the state of playback as text for the progress bar."""
        seconds = 0.0 if self.first_ns is None else (self.position_ns - self.first_ns) / 1e9
        state = "paused" if self.is_paused else "full speed" if self.rate is None else f"{self.rate:g}x real time"
        return f"at {seconds:.1f} s of the log, {state}"


class PlayedSource(SourceAround):
    """A `Source` that follows a clock; `start_s` and `end_s` are seconds from the first frame of the log."""

    def __init__(
        self,
        source: Source,
        clock: PlaybackClock,
        *,
        start_s: float = 0.0,
        end_s: float | None = None,
        keyframes: KeyframeConfig | None = None,
    ) -> None:
        super().__init__(source)
        self._clock = clock
        self._start_s = start_s
        self._end_s = end_s
        self._keyframes = keyframes or KeyframeConfig()
        self._num_skipped = 0
        self._num_seeks = 0

    @property
    def info(self) -> SourceInfo:
        """The info of the other source; if only a part is played, the number of frames is unknown."""
        info = self._source.info
        return info if self._start_s <= 0 and self._end_s is None else replace(info, num_frames=None)

    def frames(self) -> Generator[RawFrame]:
        """Yield the frames when they are due; the first one after a seek back is marked, and has an earlier stamp.

        A jump of the odometry in a skipped part moves to the next frame. Raises `InputError`: the log is too short.
        """
        self._num_skipped = 0
        index, last, goes_back = 0, None, False
        jump: NDArray[np.float64] | None = None
        target_ns: int | None = None
        is_playing = True
        while is_playing:
            is_playing = False
            first_ns: int | None = None
            end_ns = 0
            for frame in self._source.frames():
                first_ns = frame.stamp_ns if first_ns is None else first_ns
                end_ns = max(end_ns, frame.stamp_ns)
                if target_ns is None and self._start_s > 0:
                    target_ns = first_ns + round(self._start_s * 1e9)
                if self._end_s is not None and frame.stamp_ns > first_ns + self._end_s * 1e9:
                    break
                if target_ns is not None and frame.stamp_ns < target_ns:
                    self._num_skipped += 1
                    jump = None if goes_back else both_jumps(jump, frame.after_from_before)
                    continue
                keyframe = is_keyframe(last, frame.stamp_ns, frame.world_from_camera, self._keyframes)
                self._clock.wait(frame.stamp_ns, is_keyframe=keyframe)
                sought_ns = self._clock.take_seek()
                if sought_ns is not None:
                    target_ns = sought_ns
                    self._num_seeks += 1
                    if sought_ns < frame.stamp_ns:
                        last, is_playing, goes_back, jump = None, True, True, None
                        break
                    if sought_ns > frame.stamp_ns:
                        self._num_skipped += 1
                        jump = None if goes_back else both_jumps(jump, frame.after_from_before)
                        continue
                if keyframe:
                    last = Keyframe(stamp_ns=frame.stamp_ns, world_from_camera=frame.world_from_camera)
                yield replace(
                    frame,
                    index=index,
                    decode=partial(_renumbered, frame.decode, index),
                    after_from_before=both_jumps(jump, frame.after_from_before),
                    goes_back=goes_back,
                )
                index, goes_back, jump = index + 1, False, None
            if index == 0 and first_ns is not None and self._start_s > (length_s := (end_ns - first_ns) / 1e9):
                found = f"found --start {self._start_s:g}"
                raise InputError(f"{found}, but the log is only {length_s:.1f} s long; begin earlier")

    def ledger(self) -> Mapping[str, int]:
        """Return the ledger of the other source, and the numbers of skipped frames and of seeks."""
        own = {"frames_skipped": self._num_skipped, "seeks": self._num_seeks}
        return {**self._source.ledger(), **{name: count for name, count in own.items() if count}}

    @property
    def num_seeks(self) -> int:
        """The number of seeks so far."""
        return self._num_seeks + super().num_seeks

    def interrupt(self) -> None:
        """Wake the thread that waits for a frame, since the run is to end."""
        self._clock.stop()

    def close(self) -> None:
        """Close the other source."""
        self._clock.stop()
        self._source.close()


def _renumbered(decode: Callable[[], Frame], index: int) -> Frame:
    return replace(decode(), index=index)
