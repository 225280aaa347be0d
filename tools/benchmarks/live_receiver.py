"""The receiver of a live route in a process of its own: reads or maps until its standard input ends."""

from __future__ import annotations

import argparse
import asyncio
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil

from hickory_stream.base.json_text import dumps
from hickory_stream.ports import SourceAround
from players.live import open_live
from players.live.inbox import Inbox
from players.live.recorder import Recorder
from players.messages.header_stamp import serialized_stamp_ns

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hickory_stream.engine.mapper import Mapper
    from hickory_stream.map_folder.writer import MapFolder
    from hickory_stream.ports import Sink
    from hickory_stream.records import RawFrame
    from players.live import LiveMapSource
    from players.logs.containers import LogMessage, Topic

_DRAINED_S = 3.0
_LEAST_FRAMES = 15


class Watched(SourceAround):
    """Notes when frames come out, and how long after the last of their images."""

    def __init__(self, source: LiveMapSource, arrivals: dict[int, int], inbox: Inbox) -> None:
        super().__init__(source)
        self._arrivals = arrivals
        self._inbox = inbox
        self.waits_s: dict[int, float] = {}
        self.came_s: list[float] = []
        self.stamps_ns: list[int] = []
        self.used_s: list[tuple[float, float]] = []
        self.began_s = self.ended_s = (0.0, 0.0)

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames of the other one."""
        began_ns = self._inbox.clock()
        self.began_s = self.ended_s = (time.monotonic(), time.process_time())
        for frame in self._source.frames():
            arrived_ns = self._arrivals.pop(frame.stamp_ns, None)
            # What came while the route was being opened has waited for that.
            if arrived_ns is not None and arrived_ns > began_ns:
                self.waits_s[frame.stamp_ns] = (self._inbox.clock() - arrived_ns) / 1e9
                self.used_s.append((time.monotonic(), time.process_time()))
            self.ended_s = (time.monotonic(), time.process_time())
            self.came_s.append(time.time())
            self.stamps_ns.append(frame.stamp_ns)
            yield frame


def main() -> None:
    """Receive, and print what came of it."""
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
    peak_mb = [0.0]
    threading.Thread(target=_watch_memory, args=(peak_mb,), daemon=True).start()
    threading.Thread(target=_end_with_input, args=(source, inbox), daemon=True).start()
    try:
        if mapper is None:
            for _ in watched.frames():
                pass
        else:
            published = _publisher(source) if options.publish else None
            asyncio.run(_map(mapper, watched, published))
        account = source.account()
        status = source.status()
    finally:
        # Zenoh's threads live until their subscribers are undeclared, and Python waits for them.
        source.close()
        if recorder is not None:
            recorder.close()
    print(
        dumps(
            {
                "totals": {entry.topic: entry.total for entry in account.topics},
                "difference": account.as_dict()["difference"],
                "lost": {entry.topic: entry.lost for entry in status.topics},
                "frames": len(watched.came_s),
                "came_s": watched.came_s,
                "stamps_ns": watched.stamps_ns,
                "cpu_share": _share(watched),
                "wait_s": list(watched.waits_s.values()),
                "latency_s": _latencies(options.out, watched) if options.out is not None else [],
                "peak_mb": peak_mb[0],
                "lost_of_recording": recorder.lost if recorder is not None else "",
            }
        )
    )


def _publisher(source: LiveMapSource) -> Sink:
    from hickory_stream.navigation.robot import load_robot
    from hickory_stream.sinks.publish_sink import PublishSink

    assert source.return_link is not None
    return PublishSink(load_robot("point"), source.return_link, odom_frame=source.odom_frame)


def _mapper(out: Path, *, has_shapes: bool) -> Mapper:
    # Imported here: whoever does not map is there sooner.
    from hickory_stream.config import MapperConfig
    from hickory_stream.engine.mapper import Mapper

    config = MapperConfig()
    if not has_shapes:
        requests = replace(config.mapping.requests, max_failures=0)
        config = replace(config, mapping=replace(config.mapping, requests=requests))
    mapper = Mapper(replace(config, run=replace(config.run, workers=1)), out=out, overwrite=True)
    # A robot that waits for a listener begins as soon as there is one.
    mapper.rehearse()
    return mapper


async def _map(mapper: Mapper, source: Watched, published: Sink | None) -> None:
    from hickory_stream.sinks.disk_sink import DiskSink

    def sinks(folder: MapFolder) -> list[tuple[Sink, bool]]:
        return [(DiskSink(folder), True), *([(published, False)] if published is not None else [])]

    async with mapper:
        async for _ in mapper.run(source, sinks=sinks, mode="live"):
            pass


def _latencies(out: Path, watched: Watched) -> list[float]:
    """Return seconds from the last image of each keyframe to its snapshot."""
    from hickory_stream.journal.reader import Journal

    with Journal(out) as journal:
        steps = [journal.step(i) for i in range(len(journal)) if journal.step(i).kind == "keyframe"]
    found: list[float] = []
    for step in steps:
        latency_s: Any = dict(step.metrics).get("time/latency")
        if latency_s is not None and step.stamp_ns in watched.waits_s:
            found.append(latency_s + watched.waits_s[step.stamp_ns])
    return found


def _share(watched: Watched) -> float:
    """Return the share of a core while frames came one by one; while any did, where those were too few."""
    came = watched.used_s if len(watched.used_s) >= _LEAST_FRAMES else [watched.began_s, watched.ended_s]
    (began_s, cpu_before_s), (ended_s, cpu_after_s) = came[0], came[-1]
    return (cpu_after_s - cpu_before_s) / max(ended_s - began_s, 1e-3)


def _end_with_input(source: LiveMapSource, inbox: Inbox) -> None:
    """End when standard input ends, once what has come was read."""
    sys.stdin.read()
    ends_s = time.monotonic() + _DRAINED_S
    while inbox.waiting() and time.monotonic() < ends_s:
        time.sleep(0.05)
    time.sleep(0.3)
    source.interrupt()


def _watch_memory(peak_mb: list[float]) -> None:
    process = psutil.Process()
    while True:
        peak_mb[0] = max(peak_mb[0], process.memory_info().rss / 1e6)
        time.sleep(0.05)


if __name__ == "__main__":
    main()
