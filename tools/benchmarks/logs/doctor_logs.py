"""Whole logs for `doctor`: calibrations that are wrong, logs whose map is empty, and one of ten minutes."""
# Each is made of the embedded recording. A map that is empty must end `play` with another status than 0, and `doctor`
# must not call its log sound.

import contextlib
import copy
import io
import json
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.cli import main
from players import SourceOptions
from players.doctor.diagnosis import SOUND, examine
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.damage.damaging import write_mcap
from tools.worlds.ros_bags import RosMessages

_DEMO = Path("recordings/demo.mcap")
_SECONDS, _LONG_S, _QUICK_LONG_S = 6.0, 600.0, 120.0
_COLOR, _DEPTH, _INFOS = "/front/image", "/front/depth/image", ("/front/camera_info", "/front/depth/camera_info")
_NAMES = {
    "/zed/zed_node/rgb/color/rect/image/compressed": _COLOR,
    "/zed/zed_node/rgb/color/rect/camera_info": _INFOS[0],
    "/zed/zed_node/depth/depth_registered/compressedDepth": _DEPTH,
    "/zed/zed_node/depth/camera_info": _INFOS[1],
    "/zed/zed_node/odom": "/odom",
}
_POSES = ("/odom", "/tf")


@dataclass(slots=True)
class Row:
    """A message of a log."""

    topic: str
    log_ns: int
    message: Any


Change = Callable[[list[Row]], None]


@cache
def _ros() -> RosMessages:
    return RosMessages(2)


def _rows(start_s: float, seconds: float) -> list[Row]:
    # Raw images: colour rgb8, depth 16UC1 in mm.
    from mcap.reader import make_reader

    rows, store = list[Row](), _ros().store
    pixels: NDArray[Any] | None
    with _DEMO.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            topic = _NAMES.get(channel.topic, channel.topic)
            assert schema is not None
            rows.append(Row(topic, message.log_time, store.deserialize_cdr(message.data, schema.name)))
    first_ns = rows[0].log_ns + round(1e9 * start_s)
    chosen = [row for row in rows if row.topic == "/tf_static" or 0 <= row.log_ns - first_ns <= 1e9 * seconds]
    for row in chosen:
        if row.topic in (_COLOR, _DEPTH):
            skip, header = 12 * (row.topic == _DEPTH), row.message.header
            pixels = cv2.imdecode(np.asarray(row.message.data[skip:]), cv2.IMREAD_UNCHANGED)
            assert pixels is not None
            encoding, pixels = ("16UC1", pixels) if skip else ("rgb8", pixels[:, :, ::-1])
            stamp_ns = header.stamp.sec * 10**9 + header.stamp.nanosec
            row.message = _ros().image(stamp_ns, header.frame_id, encoding, np.ascontiguousarray(pixels))
    return chosen


def write_log(path: Path, rows: Iterator[Row] | list[Row]) -> Path:
    """Write an MCAP file without compression, as recorders do for raw images."""
    return write_mcap(path, ((row.topic, row.log_ns, row.message) for row in rows), "none", 4 << 20)


def _headers(row: Row) -> list[Any]:
    return [link.header for link in row.message.transforms] if row.topic.startswith("/tf") else [row.message.header]


def _stamp_ns(row: Row) -> int:
    stamp = _headers(row)[0].stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _move(row: Row, by_ns: int) -> None:
    for header in _headers(row):
        stamp_ns = header.stamp.sec * 10**9 + header.stamp.nanosec + by_ns
        header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 10**9)


def _each(topics: tuple[str, ...], change: Callable[[Any], None]) -> Change:
    def changed(rows: list[Row]) -> None:
        for row in rows:
            if row.topic in topics:
                change(row.message)

    return changed


def _pixels(topic: str, change: Callable[[NDArray[Any]], NDArray[Any]], encoding: str = "") -> Change:
    def changed(image: Any) -> None:
        before = np.asarray(image.data).view(np.uint16 if image.encoding == "16UC1" else np.uint8)
        after = change(before.reshape(image.height, image.width, -1))
        image.data = np.ascontiguousarray(after).view(np.uint8).ravel()
        image.encoding, image.step = encoding or image.encoding, len(image.data) // image.height

    return _each((topic,), changed)


def _late(seconds: float, *topics: str) -> Change:
    def changed(rows: list[Row]) -> None:
        for row in rows:
            if row.topic in topics:
                _move(row, round(1e9 * seconds))

    return changed


def _without(*topics: str, from_s: float = 0.0) -> Change:
    def changed(rows: list[Row]) -> None:
        first_ns = min(row.log_ns for row in rows if row.topic != "/tf_static")
        rows[:] = [row for row in rows if row.topic not in topics or row.log_ns - first_ns < 1e9 * from_s]

    return changed


def _poses(change: Callable[[Any], None]) -> Change:
    def changed(rows: list[Row]) -> None:
        for row in rows:
            if row.topic == "/odom":
                change(row.message.pose.pose)
        rows[:] = [row for row in rows if row.topic != "/tf"]

    return changed


def _in_mm(pose: Any) -> None:
    for axis in "xyz":
        setattr(pose.position, axis, 1000 * getattr(pose.position, axis))


def _rest(rows: list[Row]) -> None:
    first = {row.topic: row.message for row in reversed(rows)}
    for row in rows:
        now, row.message = _headers(row), copy.deepcopy(first[row.topic])
        for header, other in zip(_headers(row), now, strict=True):
            header.stamp = other.stamp


def _cut_short(image: Any) -> None:
    image.data = image.data[: len(image.data) // 3]


def _other_k(info: Any) -> None:
    info.k, info.p = info.k * ([2.0] * 8 + [1.0]), info.p * ([2.0] * 10 + [1.0] * 2)


def _with(**values: Any) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        for name, value in values.items():
            setattr(message, name, value)

    return change


_no_k = _with(k=np.zeros(9), p=np.zeros(12))
CALIBRATIONS: dict[str, tuple[Callable[[Any], None], str]] = {
    "K of zeros": (_no_k, "K|focal|calibrat"),
    "K of twice the size": (_other_k, "K|focal|size|middle|calibrat|far for|near for"),
    "D of NaN": (_with(distortion_model="plumb_bob", d=np.full(5, np.nan)), "D |distortion"),
    "another size": (_with(width=1920, height=800), "size|pixels|1920"),
    "D of 17 numbers": (_with(distortion_model="plumb_bob", d=np.full(17, 0.01)), "D |distortion|coefficients"),
    "an unknown lens": (_with(distortion_model="own_model", d=np.full(5, 0.1)), "own_model|distortion|lens"),
}

# Logs whose map would be empty, or worthless.
EMPTY: dict[str, Change] = {
    "depth of zeros": _pixels(_DEPTH, np.zeros_like),
    "depth of NaN": _pixels(_DEPTH, lambda depth: np.full(depth.shape, np.nan, np.float32), "32FC1"),
    "depth of infinity": _pixels(_DEPTH, lambda depth: np.full(depth.shape, np.inf, np.float32), "32FC1"),
    "depth in mm as floats": _pixels(_DEPTH, lambda depth: depth.astype(np.float32), "32FC1"),
    "depth at its limit": _pixels(_DEPTH, lambda depth: np.full_like(depth, 65535)),
    "depth of 5 cm": _pixels(_DEPTH, lambda depth: np.full_like(depth, 50)),
    "depth in metres": _pixels(_DEPTH, lambda depth: (depth // 1000).astype(np.uint16)),
    "depth of 8 bits": _pixels(_DEPTH, lambda depth: (depth // 40).astype(np.uint8), "mono8"),
    "depth in 0.1 mm": _pixels(_DEPTH, lambda depth: np.minimum(depth * 10.0, 65535).astype(np.uint16)),
    "depth cut short": _each((_DEPTH,), _cut_short),
    "colour cut short": _each((_COLOR,), _cut_short),
    "colour black": _pixels(_COLOR, np.zeros_like),
    "a camera that rests": _rest,
    "colour of an hour later": _late(3600.0, _COLOR),
    "depth of a minute later": _late(60.0, _DEPTH),
    "poses of an hour later": _late(3600.0, *_POSES),
    "poses that end": _without(*_POSES, from_s=0.5),
    "depth that ends": _without(_DEPTH, from_s=0.3),
    "colour that ends": _without(_COLOR, from_s=0.3),
    "no calibration": _without(*_INFOS),
    "no links": _without("/tf_static"),
    "poses of NaN": _poses(lambda pose: _with(x=np.nan)(pose.position)),
    "turns of zero": _poses(lambda pose: _with(x=0.0, y=0.0, z=0.0, w=0.0)(pose.orientation)),
    "poses in mm": _poses(_in_mm),
    "K of zeros": _each(_INFOS, _no_k),
}
_QUICK_EMPTY = 3


def measure(options: Options, folder: Path) -> list[Figure]:
    """Return how many empty maps nothing speaks of, and how long `doctor` takes on a long log."""
    names = list(EMPTY)[: _QUICK_EMPTY if options.quick else None]
    silent = sum(_is_silent(name, folder) for name in names)
    return [
        figure("silent_empty_maps", silent, "", "lower", of=f"{len(names)} logs without a map"),
        _time_of_a_long_log(folder, _QUICK_LONG_S if options.quick else _LONG_S),
    ]


def is_calibration_found(folder: Path, rng: np.random.Generator) -> bool:
    """Return whether `doctor` names a wrong calibration, which is drawn."""
    name = str(rng.choice(sorted(CALIBRATIONS)))
    change, word = CALIBRATIONS[name]
    rows = _rows(float(rng.uniform(0, 24.0 - _SECONDS)), _SECONDS)
    _each(_INFOS, change)(rows)
    found = examine([write_log(folder / "calibration.mcap", rows)], SourceOptions())
    said = " ".join([found.refusal or "", *found.problems])
    is_found = re.search(word, said) is not None
    if not is_found:
        print(f"  not found: {name}: {said}", flush=True)
    return is_found


def _is_silent(name: str, folder: Path) -> bool:
    rows = _rows(2.0, _SECONDS)
    EMPTY[name](rows)
    log = write_log(folder / "empty.mcap", rows)
    verdict = examine([log], SourceOptions())
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
        arguments = ["play", str(log), "--out", str(folder / "empty.map"), "--overwrite", "--viewer", "none", "--json"]
        status = main(arguments)
    lines = [json.loads(line) for line in said.getvalue().splitlines() if line.startswith('{"')]
    objects = next((line["objects"] for line in lines if line.get("event") == "finished"), 0)
    is_silent = objects == 0 and (status == 0 or verdict.status == SOUND)
    text = verdict.refusal or "; ".join(verdict.problems) or "sound"
    print(f"  {name}: {objects} objects, status {status}; doctor {verdict.status}: {text[:150]}", flush=True)
    return is_silent


def _time_of_a_long_log(folder: Path, seconds: float) -> Figure:
    log = write_log(folder / "long.mcap", long_rows(seconds))
    begun_s = time.process_time()
    found = examine([log], SourceOptions())
    took_s, megabytes = time.process_time() - begun_s, log.stat().st_size / 1e6
    if found.status != SOUND:
        print(f"  false alarm in a long log: {found.refusal or found.problems}", flush=True)
    log.unlink()
    return figure("doctor_s", took_s, "s", "lower", of=f"{megabytes:.0f} MB of {seconds:.0f} s, processor time")


def long_rows(seconds: float) -> Iterator[Row]:
    """Yield the recording forth and back again, so often as it takes."""
    rows = _rows(0.0, np.inf)
    yield from (row for row in rows if row.topic == "/tf_static")
    rows = [row for row in rows if row.topic != "/tf_static"]
    stamps_ns = [_stamp_ns(row) for row in rows]
    first_ns, last_ns = min(stamps_ns), max(stamps_ns)
    for turn in range(int(np.ceil(seconds * 1e9 / (last_ns - first_ns)))):
        base_ns = first_ns + turn * (last_ns - first_ns + 10_000_000)
        for i in range(len(rows)) if turn % 2 == 0 else reversed(range(len(rows))):
            row, now_ns = rows[i], _stamp_ns(rows[i])
            to_ns = base_ns + (stamps_ns[i] - first_ns if turn % 2 == 0 else last_ns - stamps_ns[i])
            _move(row, to_ns - now_ns)
            yield Row(row.topic, to_ns + row.log_ns - stamps_ns[i], row.message)
