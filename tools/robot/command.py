"""`tools/fake_robot LOG --via ROUTE`: the command line."""

import argparse
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hickory_stream.base.json_text import dumps
from hickory_stream.errors import HickoryError, InputError
from hickory_stream.sinks.ros_messages import goal_message
from tools.robot.drive import drive
from tools.robot.link import Faults, plan
from tools.robot.prepared import prepared
from tools.robot.publishers import Publisher

ROUTES = ("zenoh-bridge", "rmw-zenoh", "foxglove", "dds", "mcap")
_PORTS = {"zenoh-bridge": 7447, "rmw-zenoh": 7447, "foxglove": 8765}


def publisher_of(options: argparse.Namespace) -> Publisher:
    """Return the publisher that the options name; on the loopback address unless told otherwise."""
    if options.via == "mcap":
        from tools.robot.publishers import McapPublisher

        if options.listen is None:
            raise InputError("found --via mcap without --listen, expected --listen PIPE, the pipe or file to write")
        return McapPublisher(Path(options.listen))
    if options.via == "dds":
        from tools.robot.dds_publisher import DdsPublisher

        return DdsPublisher(options.domain)
    address = options.listen or f"127.0.0.1:{_PORTS[options.via]}"
    if options.via == "foxglove":
        from tools.robot.foxglove_publisher import FoxglovePublisher

        return FoxglovePublisher(address)
    from tools.robot.zenoh_publishers import RmwZenoh, ZenohBridge

    if options.via == "rmw-zenoh":
        return RmwZenoh(address, domain=options.domain, namespace=options.namespace)
    return ZenohBridge(address, namespace=options.namespace, is_old=options.old_bridge)


def main(arguments: Sequence[str] | None = None) -> int:
    """Play a log as a robot, print what was sent as JSON, and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="tools/fake_robot", description="Play a log as a robot that publishes it, over a link that may be bad."
    )
    parser.add_argument("log", nargs="+", type=Path)
    parser.add_argument("--via", required=True, choices=ROUTES)
    parser.add_argument("--listen", metavar="HOST:PORT|PIPE", help="where it can be reached (this machine only)")
    parser.add_argument("--namespace", default="", help="of all topics")
    parser.add_argument("--domain", type=int, default=0, help="the ROS domain (rmw-zenoh, dds)")
    parser.add_argument("--old-bridge", action="store_true", help="a bridge before 1.5, with its publication cache")
    parser.add_argument("--rate", type=float, default=1.0, help="so many times as fast as it was recorded")
    parser.add_argument("--loop", type=int, default=1, metavar="N", help="play it N times; stamps begin again")
    parser.add_argument("--seconds", type=float, metavar="S", help="only the beginning of the log")
    parser.add_argument("--wait", action="store_true", help="begin when somebody listens")
    parser.add_argument("--loss", type=float, default=0.0, metavar="SHARE", help="of the messages never arrive")
    parser.add_argument("--delay", type=float, default=0.0, metavar="MS", help="of every message")
    parser.add_argument("--jitter", type=float, default=0.0, metavar="MS", help="more, at random; messages overtake")
    parser.add_argument("--bandwidth", type=float, metavar="MBIT/S", help="what the link carries")
    parser.add_argument(
        "--disconnect", action="append", default=[], metavar="AT:FOR", help="be gone, seconds; repeatable"
    )
    parser.add_argument("--clock-offset", type=float, default=0.0, metavar="S", help="of the robot's clock")
    parser.add_argument("--restart", type=float, metavar="AT", help="from then on the clock begins at zero")
    parser.add_argument(
        "--goal", action="append", default=[], metavar="AT:X,Y", help="ask for a path then (--publish); repeatable"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    try:
        faults = _faults(options)
        made = plan(prepared(options.log, most_s=options.seconds, loops=options.loop), faults)
        publisher = publisher_of(options)
        print("ready", file=sys.stderr, flush=True)
        goals = [_goal(text) for text in options.goal]
        report = drive(made, publisher, faults, rate=options.rate, waits=options.wait, stopped=stopped, goals=goals)
    except HickoryError as error:
        print(f"tools/fake_robot: {error}", file=sys.stderr)
        return error.exit_status
    except BrokenPipeError:
        print("tools/fake_robot: nobody reads the pipe any more", file=sys.stderr)
        return 2
    print(dumps(report.as_dict()))
    return 0


def _goal(text: str) -> tuple[float, bytes]:
    try:
        at, _, place = text.partition(":")
        x, y = map(float, place.split(","))
        return float(at), goal_message(0, np.array([x, y]))
    except ValueError as error:
        raise InputError(f"found --goal {text}, expected AT:X,Y in seconds and metres, e.g. 5:1.5,0") from error


def _faults(options: argparse.Namespace) -> Faults:
    try:
        disconnects = tuple((float(at), float(s)) for at, _, s in (text.partition(":") for text in options.disconnect))
    except ValueError as error:
        raise InputError(f"found --disconnect {options.disconnect}, expected AT:FOR in seconds, e.g. 10:30") from error
    if not 0 <= options.loss <= 1:
        raise InputError(f"found --loss {options.loss:g}, expected a share of 0 to 1, e.g. 0.1")
    return Faults(
        loss=options.loss,
        delay_s=options.delay / 1e3,
        jitter_s=options.jitter / 1e3,
        bandwidth_mbit=options.bandwidth,
        disconnects=disconnects,
        clock_offset_s=options.clock_offset,
        restart_s=options.restart,
        seed=options.seed,
    )


if __name__ == "__main__":
    sys.exit(main())
