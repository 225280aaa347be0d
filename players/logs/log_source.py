"""A recorded log as a source: images are paired and poses interpolated in one pass.

Opening reads up to the first complete frame, so that an unusable log is refused before anything is written.
A pair waits until poses up to its stamp have been read, or none can be expected.
"""

import logging
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import chain, groupby

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import CalibrationError, RecordingError
from hickory_stream.geometry.rigid import compose, invert
from hickory_stream.records import Frame, RawFrame, Scan, SourceInfo
from players.logs.clock_steps import ClockSteps, Timed
from players.logs.containers import Log, LogMessage, Topic, UnreadableMessageError, deserialize, files_identity
from players.logs.log_damage import Flaws
from players.logs.log_parts import parts_of
from players.logs.log_setup import LogSetup
from players.logs.message_account import Account, Ledger, account_of
from players.logs.synchronizer import Leftover, Pair, Stamped, pair_epochs
from players.logs.timeline import Order, Timeline
from players.messages.calibration import Lens
from players.messages.depth_registration import Registration, register_depth, with_motion
from players.messages.header_stamp import serialized_stamp_ns
from players.messages.images import LogImage, color_of, depth_of, image_of
from players.messages.point_clouds import scan_of
from players.messages.records import CAMERA_INFO, POINT_CLOUD
from players.poses.camera_poses import UNPOSED, PosePlan, PoseReader
from players.poses.pose_gaps import PoseGaps
from players.poses.tf import FrameTree

logger = logging.getLogger(__name__)

_PATIENCE_NS = 500_000_000
"""How long, beyond the widest gap between poses, a pair waits for poses; it bounds the memory."""

_KEPT_NS = 5_000_000_000
"""How long poses older than the current frame are kept."""

_LAG_NS, _OTHER_CLOCK_NS = 200_000_000, 60_000_000_000

_KEPT_WITHOUT_FRAMES_NS = 60_000_000_000
_FORGET_EVERY = 5000


class LogSource:
    """A `Source` of a recorded log."""

    def __init__(self, log: Log, setup: LogSetup) -> None:
        """Read up to the first frame.

        Raises `RecordingError`: there is no frame with colour, depth and a pose; the message says which do not coincide
        in time; `CalibrationError`: all images have another size than their calibration.
        """
        self._log = log
        self.setup = setup
        self._ledger = Ledger()
        self._plan, self._registration = setup.plan, setup.registration
        self._clock = ClockSteps()
        self._reader: PoseReader | None = None
        #: Of the latest pass.
        self.gaps = PoseGaps()
        first = next(self.frames(), None)
        if first is None:
            raise self._why_empty()
        numbers = (setup.topics.color.num_messages, setup.topics.depth.num_messages)
        #: `num_frames` is an upper bound: images may lack partners.
        self.info = SourceInfo(
            uri=str(log.path),
            kind=log.kind,
            identity=files_identity(log.files),
            camera=setup.registration.color_camera,
            num_frames=None if None in numbers else min(n for n in numbers if n is not None),
            start_ns=first.stamp_ns,
            end_ns=None,
            streams=setup.streams,
        )

    def findings(self) -> Mapping[str, bool]:
        """Return faults of transforms and clocks, of the opening and the latest pass, and whether each does harm."""
        found = self._reader.faults() if self._reader is not None else {}
        found = {self._lag_text(): False, self.gaps.finding(): True, **found}
        found = {**dict.fromkeys(self.setup.findings, False), **self._clock.texts, **found}
        return {text: is_harmful for text, is_harmful in found.items() if text}

    @property
    def num_clock_steps(self) -> int:
        """How often a clock was set in the latest pass."""
        return len(self._clock.texts)

    def with_plan(self, plan: PosePlan) -> "LogSource":
        """Return the same log with poses from another plan.

        Raises `RecordingError`: no frame has a pose by that plan.
        """
        streams = {**dict(self.setup.streams), "frames": plan.path, "extrinsics": plan.extrinsics}
        return LogSource(self._log, replace(self.setup, plan=plan, streams=tuple(streams.items())))

    def clouds(self) -> tuple[str, ...]:
        """Return the topics of point clouds, those with the most messages first."""
        clouds = [topic for topic in self._log.topics if topic.type_name == POINT_CLOUD and topic.num_messages != 0]
        return tuple(topic.name for topic in sorted(clouds, key=lambda t: (-(t.num_messages or 0), t.name)))

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames in the order of their stamps, which begin again after a jump back in time (a looped log)."""
        ledger = self._ledger = Ledger()
        setup = self.setup
        reader = PoseReader(setup.small_topics, setup.max_gap_ns, setup.jump_limits, uses_log_time=setup.uses_log_time)
        self._plan, self._registration = setup.plan, setup.registration
        self._clock, self._reader, self.gaps = ClockSteps(), reader, PoseGaps()
        num_static = 0
        if setup.pose_file is not None and setup.plan.stream is not None:
            reader.load(setup.plan.stream, *setup.pose_file)
        waiting: deque[tuple[int, Pair]] = deque()
        newest: dict[int, int] = {}
        index, last_ns = 0, None
        matches = pair_epochs(self._images(ledger, reader, newest), setup.tolerance_ns, is_live=setup.is_live)
        is_ended = False
        while not is_ended or waiting:
            match = next(matches, None)
            if match is None:
                is_ended = True
            elif match[1] is None:
                pass  # The message may be the pose that the first pair waits for.
            elif isinstance(match[1], Leftover):
                fate = _fate_of(match[1])
                ledger.count(fate)
                ledger.reject(match[1].item.topic, fate)
            else:
                waiting.append((match[0], match[1]))
            if num_static < reader.num_static and self._relink(reader.tree()):
                num_static = reader.num_static
            while waiting and (is_ended or self._is_settled(*waiting[0], reader, newest)):
                epoch, pair = waiting.popleft()
                frame = self._frame(index, pair, epoch, last_ns, ledger, reader)
                if frame is not None:
                    index += 1
                    last_ns = frame.stamp_ns
                    reader.forget(frame.stamp_ns - setup.corrections.pose_offset_ns - _KEPT_NS)
                    yield frame
        reader.end()
        for fate, number in reader.fates.items():
            ledger.count(fate, number)
        if reader.error:
            ledger.reasons.setdefault("unreadable_message", reader.error)
        for topic, number in reader.rejected.items():
            ledger.rejected[topic, "bad_pose"] += number
        ledger.is_complete = True

    def scans(self, topic_name: str) -> Iterator[Scan]:
        """Yield the sweeps of a LiDAR's topic (`sensor_msgs/PointCloud2`), for odometry; unreadable ones are skipped.

        Raises `RecordingError`: there is no such topic.
        """
        clouds = {topic.name: topic for topic in self._log.topics if topic.type_name == POINT_CLOUD}
        if topic_name not in clouds:
            there = f"those of point clouds are {', '.join(sorted(clouds))}" if clouds else "it has no point clouds"
            raise RecordingError(f"{self._log.path} has no point clouds in {topic_name}; {there}")
        for message in self._log.messages([topic_name]):
            stamp_ns = message.log_ns if self.setup.uses_log_time else None
            try:
                yield scan_of(deserialize(clouds[topic_name], message.data), stamp_ns)
            except (UnreadableMessageError, RecordingError) as error:
                logger.warning("%s: a sweep at %.3f s is skipped: %s", topic_name, message.log_ns / 1e9, error)

    def ledger(self) -> Mapping[str, int]:
        """Return the counts of the latest pass.

        Each image is counted under `frames`, `no_pose`, `frame_of_other_size` (pairs) or under one other name.
        `unreadable_image` and `depth_without_returns` are found on decoding, among the `frames`.
        """
        return self._ledger.as_dict()

    @property
    def flaws(self) -> Flaws:
        """The damage found so far, with packets of video that give no picture."""
        return self._log.flaws

    def reasons(self) -> Mapping[str, str]:
        """Return the first error of the latest pass by the name of its count."""
        return dict(self._ledger.reasons)

    def account(self) -> Account:
        """Return the ledger of every message in the latest pass."""
        return replace(account_of(self._log, self.setup, self._ledger), findings=tuple(self.findings()))

    def close(self) -> None:
        """Do nothing: each pass over the log opens and closes its own files."""

    def _images(
        self, ledger: Ledger, reader: PoseReader, newest: dict[int, int]
    ) -> Iterator[tuple[int, Stamped | None]]:
        # For a live log, None stands for other messages.
        topics = self.setup.topics
        roles = {topics.color.name: ("color", topics.color), topics.depth.name: ("depth", topics.depth)}
        timelines = {name: Timeline() for name in roles}
        for timed, clock in self._timed(ledger):
            message = timed.message
            if clock < 0:
                ledger.count("time_not_certain")
                ledger.reject(message.topic, "time_not_certain")
                continue
            if message.topic not in roles:
                reader.add(message, clock, timed.shift_ns)
                if self.setup.is_live:
                    if ledger.read[message.topic] % _FORGET_EVERY == 0:
                        # Poses are otherwise dropped per frame: without images, a camera that is off would fill the
                        # memory.
                        reader.forget_older(_KEPT_WITHOUT_FRAMES_NS)
                    yield 0, None
                continue
            stream, topic = roles[message.topic]
            # Without a stamp it is too short for a header, hence unreadable.
            stamp_ns = message.log_ns if timed.stamp_ns is None else timed.stamp_ns
            stamp_ns += self.setup.corrections.depth_offset_ns if stream == "depth" else 0
            for placed in timelines[message.topic].add(stamp_ns, message, clock):
                if placed.order in (Order.OFF, Order.DUPLICATE):
                    fate = f"{stream}_stamp_off" if placed.order is Order.OFF else f"duplicate_{stream}"
                    ledger.count(fate)
                    ledger.reject(message.topic, fate)
                    continue
                image = self._image(topic, placed.item, placed.stamp_ns, ledger)
                if image is not None:
                    newest[placed.epoch] = max(placed.stamp_ns, newest.get(placed.epoch, placed.stamp_ns))
                    yield placed.epoch, Stamped(stream, placed.stamp_ns, image)  # type: ignore[arg-type]
        for name, timeline in timelines.items():
            for _ in timeline.end():
                ledger.count(f"{roles[name][0]}_stamp_off")
                ledger.reject(name, f"{roles[name][0]}_stamp_off")

    def _timed(self, ledger: Ledger) -> Iterator[tuple[Timed, int]]:
        # The messages with their header stamps, and how often the clock was set back before each.
        setup = self.setup
        topics = {topic.name: topic for topic in (*setup.small_topics, setup.topics.color, setup.topics.depth)}
        unstamped = {name for name, topic in topics.items() if topic.type_name == CAMERA_INFO or "tf_static" in name}
        uses_log, parts, part = setup.uses_log_time, parts_of(self._log), 0

        def messages() -> Iterator[Timed]:
            for message in self._log.messages(set(topics)):
                name = message.topic
                ledger.read[name] += 1
                stamped = not uses_log and name not in unstamped
                stamp_ns = serialized_stamp_ns(topics[name], message.data) if stamped else None
                yield Timed(name, stamp_ns, message.log_ns, message)

        def part_of(timed: Timed) -> int:
            # Lags of one part say nothing of the clock in the next one, minutes later.
            nonlocal part
            now = parts.at(timed.log_ns) if parts is not None else None
            if now is not None and now != part:
                part = now
                self._clock.forget()
            return part

        if uses_log:
            return ((timed, 0) for timed in messages())
        if parts is None:
            return self._clock.numbered(messages())
        return chain.from_iterable(self._clock.numbered(group) for _, group in groupby(messages(), key=part_of))

    def _relink(self, tree: FrameTree) -> bool:
        # Static links hold from where they are published; until all have come, those of the opening do.
        plan = self._plan.relinked(tree)
        chain = tree.chain(*self.setup.depth_ends) if self.setup.depth_ends else None
        color_from_depth = chain.at(0) if chain is not None and chain.is_static else None
        if plan is None or (color_from_depth is None and self.setup.depth_ends):
            return False
        self._plan = plan
        if color_from_depth is not None:
            self._registration = replace(
                self._registration, color_from_depth=self.setup.corrections.between(color_from_depth)
            )
        return True

    def _image(self, topic: Topic, message: LogMessage, stamp_ns: int, ledger: Ledger) -> LogImage | None:
        try:
            return image_of(topic, deserialize(topic, message.data), stamp_ns)
        except UnreadableMessageError as error:
            ledger.count("unreadable_message")
            ledger.reasons.setdefault("unreadable_message", str(error))
            ledger.unreadable[topic.name] += 1
            return None

    def _is_settled(self, epoch: int, pair: Pair, reader: PoseReader, newest: dict[int, int]) -> bool:
        needed_ns = max(pair.stamp_ns, pair.depth_stamp_ns) if self._moves_depth(pair) else pair.stamp_ns
        offset_ns = self.setup.corrections.pose_offset_ns
        if self._plan.reaches(needed_ns - offset_ns, epoch, reader) or max(newest) > epoch:
            return True
        return newest[epoch] - pair.stamp_ns > self.setup.max_gap_ns + _PATIENCE_NS + max(0, -offset_ns)

    def _pose_at(self, stamp_ns: int, epoch: int, reader: PoseReader) -> NDArray[np.float64] | None:
        corrections = self.setup.corrections
        pose = self._plan.at(stamp_ns - corrections.pose_offset_ns, epoch, reader)
        return None if pose is None else corrections.turned(pose)

    def _moves_depth(self, pair: Pair) -> bool:
        # Log times are not the times of exposure.
        is_apart = pair.depth_stamp_ns != pair.stamp_ns
        return is_apart and not self.setup.uses_log_time and not self._registration.is_identity

    def _registration_of(
        self, pair: Pair, world_from_camera: NDArray[np.float64], epoch: int, reader: PoseReader
    ) -> Registration:
        registration = self._registration
        then = self._pose_at(pair.depth_stamp_ns, epoch, reader) if self._moves_depth(pair) else None
        return registration if then is None else with_motion(registration, compose(invert(world_from_camera), then))

    def _frame(
        self, index: int, pair: Pair, epoch: int, last_ns: int | None, ledger: Ledger, reader: PoseReader
    ) -> RawFrame | None:
        registration = self._registration
        if not (_has_size(pair.color, self.setup.color_lens) and _has_size(pair.depth, self.setup.depth_lens)):
            self._refuse(pair, "frame_of_other_size", ledger)
            return None
        plan = self._plan
        world_from_camera = self._pose_at(pair.stamp_ns, epoch, reader)
        is_posed = world_from_camera is not None and plan is not UNPOSED
        if world_from_camera is None:
            if not self.setup.estimates_poses:
                self._refuse(pair, "no_pose", ledger)
                self.gaps.unposed(partial(color_of, pair.color))
                return None
            world_from_camera = np.eye(4)
        self.gaps.posed(world_from_camera)
        ledger.count("frames")
        offset_ns, jump = self.setup.corrections.pose_offset_ns, None
        if last_ns is not None:
            jump = plan.jump_between(last_ns - offset_ns, pair.stamp_ns - offset_ns, epoch, reader)
        if jump is not None:
            ledger.count("pose_jumps")
        registered = self._registration_of(pair, world_from_camera, epoch, reader)
        is_passed_on = pair.color.is_compressed and not self.setup.color_lens.is_distorted
        return RawFrame(
            index=index,
            stamp_ns=pair.stamp_ns,
            camera=registration.color_camera,
            world_from_camera=world_from_camera,
            decode=partial(_decode, self.setup, registered, pair, index, world_from_camera, ledger),
            color_bytes=(pair.color.data() or None) if is_passed_on else None,
            after_from_before=jump.after_from_before if jump is not None else None,
            is_posed=is_posed,
        )

    def _refuse(self, pair: Pair, fate: str, ledger: Ledger) -> None:
        ledger.count(fate)
        ledger.reject(pair.color.topic, fate)
        ledger.reject(pair.depth.topic, fate)

    def _why_empty(self) -> RecordingError | CalibrationError:
        fates, path, topics = self._ledger.as_dict(), self._log.path, self.setup.topics
        if fates.get("no_pose"):
            images_ns, poses_ns = self._stamps(topics.color), self._pose_span_ns()
            lag, late_ns, apart_ns = self._lag_text(), self._late_ns(self._pose_topic), images_ns[0] - poses_ns[0]
            is_apart = poses_ns[1] < images_ns[0] or images_ns[1] < poses_ns[0]
            if not lag and is_apart and abs(apart_ns) <= _OTHER_CLOCK_NS:
                late_ns = apart_ns
                lag = f"If both are of one drive, {_offset('pose', apart_ns)} lays their beginnings on each other"
            return _with_offset(
                f"{path}: no image has a pose: images from {_span_text(images_ns)}, poses of {self.setup.plan.source} "
                f"from {_span_text(poses_ns)}; name another with --pose-topic{'. ' * bool(lag)}{lag}",
                "pose",
                late_ns if lag else 0,
            )
        if fates.get("frame_of_other_size"):
            lenses = (self.setup.color_lens.camera, self.setup.depth_lens.camera)
            sizes = " and ".join(f"{camera.width}x{camera.height}" for camera in lenses)
            return CalibrationError(
                f"{path}: the camera infos are for {sizes} pixels; no pair of images has these sizes; name others with "
                "--color-info-topic or --depth-info-topic"
            )
        tolerance, late_ns = f"{self.setup.tolerance_ns / 1e6:.1f} ms", self._late_ns(topics.depth.name)
        is_late = self.setup.tolerance_ns < abs(late_ns) < _OTHER_CLOCK_NS
        return _with_offset(
            f"{path}: no colour image has a depth image within {tolerance}: {topics.color.name} "
            f"from {_span_text(self._stamps(topics.color))}, {topics.depth.name} from "
            f"{_span_text(self._stamps(topics.depth))}; found {fates}; widen it with --sync-tolerance"
            + is_late
            * f", or if depth has another clock, {_offset('depth', late_ns)} mends it",
            "depth",
            late_ns * is_late,
        )

    def _lag_text(self) -> str:
        late_ns = self._late_ns(self._pose_topic)
        is_mended = abs(late_ns - self.setup.corrections.pose_offset_ns) <= _LAG_NS
        if is_mended or not _LAG_NS < abs(late_ns) < _OTHER_CLOCK_NS:
            return ""
        late_s, way = late_ns / 1e9, "behind" if late_ns > 0 else "ahead of"
        return (
            f"{self._pose_topic}: by log time its stamps are {abs(late_s):.1f} s {way} the images': its clock is wrong "
            f"({_offset('pose', late_ns)} or --clock log mends it), or its poses take that long to compute"
        )

    @property
    def _pose_topic(self) -> str:
        return next(iter(self.setup.plan.keys), ("",))[0]

    def _late_ns(self, topic: str) -> int:
        # How much later than colour's its messages are recorded after their stamps; 0 if that is not known.
        lags_ns = self._clock.lag_ns(self.setup.topics.color.name), self._clock.lag_ns(topic)
        return 0 if lags_ns[0] is None or lags_ns[1] is None else lags_ns[1] - lags_ns[0]

    def _pose_span_ns(self) -> tuple[int, int]:
        keys, reader = self.setup.plan.keys, self._reader
        found = [track for key in keys if reader is not None and (track := reader.track(key, 0)) is not None]
        spans = [(track.first_ns or 0, track.newest_ns or 0) for track in found if track.num_added]
        return max((start for start, _ in spans), default=0), min((end for _, end in spans), default=0)

    def _stamps(self, topic: Topic) -> tuple[int, int]:
        uses_log = self.setup.uses_log_time
        stamps = [
            m.log_ns if uses_log else serialized_stamp_ns(topic, m.data) or 0 for m in self._log.messages([topic.name])
        ]
        return (min(stamps), max(stamps)) if stamps else (0, 0)


def _decode(
    setup: LogSetup, registration: Registration, pair: Pair, index: int, pose: NDArray[np.float64], ledger: Ledger
) -> Frame:
    try:
        rgb = color_of(pair.color)
        depth_m = depth_of(pair.depth, setup.depth_units_per_m)
        if setup.corrections.depth_scale != 1:
            depth_m = depth_m * np.float32(setup.corrections.depth_scale)
        _check_size(rgb.shape, setup.color_lens, pair.color)
        _check_size(depth_m.shape, setup.depth_lens, pair.depth)
    except RecordingError as error:
        ledger.count("unreadable_image")
        ledger.reasons.setdefault("unreadable_image", str(error))
        raise
    depth_m = setup.sensor.returns(depth_m)
    if not np.isfinite(depth_m).any():
        ledger.count("depth_without_returns")
    rgb = setup.color_lens.rectified_color(rgb)
    depth_m = register_depth(setup.depth_lens.rectified_depth(depth_m), registration)
    for image in (rgb, depth_m):
        image.flags.writeable = False  # No other references exist, so that the frame need not copy the arrays.
    return Frame(
        index=index,
        stamp_ns=pair.stamp_ns,
        rgb=rgb,
        depth_m=depth_m,
        camera=registration.color_camera,
        world_from_camera=pose,
        sensor=setup.sensor,
    )


def _check_size(shape: tuple[int, ...], lens: Lens, image: LogImage) -> None:
    if shape[:2] != (lens.camera.height, lens.camera.width):
        expected = f"{lens.camera.width}x{lens.camera.height}"
        raise RecordingError(f"{image} has {shape[1]}x{shape[0]} pixels; expected {expected}")


def _has_size(image: LogImage, lens: Lens) -> bool:
    # With a damaged header, the size is known after decoding only.
    return image.size is None or image.size == (lens.camera.width, lens.camera.height)


def _fate_of(leftover: Leftover) -> str:
    if leftover.is_late:
        return f"late_{leftover.stream}"
    return "color_without_depth" if leftover.stream == "color" else "depth_without_color"


def _offset(role: str, late_ns: int) -> str:
    return f"{role}_offset_ms = {late_ns / 1e6:.0f} under [time] of a profile"


def _with_offset(text: str, role: str, late_ns: int) -> RecordingError:
    error = RecordingError(text)
    error.fixes = {"time": {f"{role}_offset_ms": round(late_ns / 1e6)}} if late_ns else {}
    return error


def _span_text(span_ns: tuple[int, int]) -> str:
    return f"{span_ns[0] / 1e9:.3f} s to {span_ns[1] / 1e9:.3f} s"
