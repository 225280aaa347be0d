"""The receiver of a live route in a process of its own: reads or maps until its standard input ends."""

import argparse
import asyncio
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hickory_stream.base.json_text import dumps
from hickory_stream.ports import SourceAround
from hickory_stream.records import RawFrame
from players.live import LiveMapSource, open_live
from players.live.inbox import Inbox
from players.live.recorder import Recorder
from players.logs.containers import LogMessage, Topic
from players.messages.header_stamp import serialized_stamp_ns
from tools.benchmarks.common.processes import NO_SHAPES, watched_peak_mb

_DRAINED_S = 3.0
_LEAST_FRAMES = 15


@dataclass(slots=True)
class Moment:
    """A moment by the clock and by the processor time of this process."""

    wall_s: float = field(default_factory=time.monotonic)
    cpu_s: float = field(default_factory=time.process_time)


class Watched(SourceAround):
    """Notes when frames come out, and how long after the last of their images."""

    def __init__(self, source: LiveMapSource, arrivals: dict[int, int], inbox: Inbox) -> None:
        super().__init__(source)
        self._arrivals = arrivals
        self._inbox = inbox
        self.waits_s: dict[int, float] = {}
        self.came_s: list[float] = []
        self.stamps_ns: list[int] = []
        self.used: list[Moment] = []
        self.began = self.ended = Moment(0.0, 0.0)

    def frames(self) -> Iterator[RawFrame]:
        began_ns = self._inbox.clock()
        self.began = self.ended = Moment()
        for frame in self._source.frames():
            arrived_ns = self._arrivals.pop(frame.stamp_ns, None)
            # Messages that came while the route was being opened have waited for that.
            if arrived_ns is not None and arrived_ns > began_ns:
                self.waits_s[frame.stamp_ns] = (self._inbox.clock() - arrived_ns) / 1e9
                self.used.append(Moment())
            self.ended = Moment()
            self.came_s.append(time.time())
            self.stamps_ns.append(frame.stamp_ns)
            yield frame

    @property
    def cpu_share(self) -> float:
        """The share of a core while frames came one by one; over all of them, where those were too few."""
        came = self.used if len(self.used) >= _LEAST_FRAMES else [self.began, self.ended]
        return (came[-1].cpu_s - came[0].cpu_s) / max(came[-1].wall_s - came[0].wall_s, 1e-3)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("uri")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--record", type=Path)
    parser.add_argument("--no-shapes", action="store_true")
    parser.add_argument("--publish", action="store_true")
    options = parser.parse_args()
    arrivals: dict[int, int] = {}
    recorder = Recorder(options.record, options.uri) if options.record is not None else None

    def tap(topic: Topic, message: LogMessage) -> None:
        if topic.type_name.endswith("Image"):
            arrivals[serialized_stamp_ns(topic, message.data) or 0] = message.log_ns
            if len(arrivals) > 10_000:
                arrivals.clear()
        if recorder is not None:
            recorder.take(topic, message)

    mapper = _mapper(options.out, has_shapes=not options.no_shapes) if options.out is not None else None
    inbox = Inbox(tap=tap)
    source = open_live(options.uri, inbox=inbox, attempt_s=0.5)
    watched = Watched(source, arrivals, inbox)
    peak_mb = watched_peak_mb()
    threading.Thread(target=_end_with_input, args=(source, inbox), daemon=True).start()
    try:
        if mapper is None:
            for _ in watched.frames():
                pass
        else:
            asyncio.run(_map(mapper, watched, _publisher(source) if options.publish else None))
        account = source.account()
        status = source.status()
    finally:
        # Zenoh's threads live until their subscribers are undeclared, and Python waits for them.
        source.close()
        if recorder is not None:
            recorder.close()
    report = {
        "totals": {entry.topic: entry.total for entry in account.topics}, "difference": account.as_dict()["difference"],
        "lost": {entry.topic: entry.lost for entry in status.topics}, "frames": len(watched.came_s),
        "came_s": watched.came_s, "stamps_ns": watched.stamps_ns, "cpu_share": watched.cpu_share,
        "wait_s": list(watched.waits_s.values()),
        "latency_s": _latencies(options.out, watched) if options.out is not None else [], "peak_mb": peak_mb[0],
    }  # fmt: skip
    print(dumps(report))


def _publisher(source: LiveMapSource) -> Any:
    from hickory_stream.navigation.robot import load_robot
    from hickory_stream.sinks.publish_sink import PublishSink

    assert source.return_link is not None
    return PublishSink(load_robot("point"), source.return_link, odom_frame=source.odom_frame)


def _mapper(out: Path, *, has_shapes: bool) -> Any:
    # Imported here: a receiver without a map starts sooner.
    from hickory_stream.base.config_text import read_config
    from hickory_stream.config import MapperConfig
    from hickory_stream.engine.mapper import Mapper

    config = read_config(MapperConfig, None, ("run.workers=1", *(() if has_shapes else (NO_SHAPES,))))
    mapper = Mapper(config, out=out, overwrite=True)
    # A robot that waits for a listener begins as soon as there is one.
    mapper.rehearse()
    return mapper


async def _map(mapper: Any, source: Watched, published: Any) -> None:
    from hickory_stream.sinks.disk_sink import DiskSink

    more = [] if published is None else [(published, False)]
    async with mapper:
        async for _ in mapper.run(source, sinks=lambda folder: [(DiskSink(folder), True), *more], mode="live"):
            pass


def _latencies(out: Path, watched: Watched) -> list[float]:
    from tools.benchmarks.live.overload import keyframe_steps

    found = []
    for step in keyframe_steps(out):
        latency_s: Any = dict(step.metrics).get("time/latency")
        if latency_s is not None and step.stamp_ns in watched.waits_s:
            found.append(latency_s + watched.waits_s[step.stamp_ns])
    return found


def _end_with_input(source: LiveMapSource, inbox: Inbox) -> None:
    sys.stdin.read()
    ends_s = time.monotonic() + _DRAINED_S
    while inbox.waiting() and time.monotonic() < ends_s:
        time.sleep(0.05)
    time.sleep(0.3)
    source.interrupt()


if __name__ == "__main__":
    main()
