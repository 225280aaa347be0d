"""A source whose poses are estimated from its LiDAR or its depth images by an `Odometry`.

The world is the log's if it has a first pose; else the first camera is the origin, levelled by visible surfaces.
Frames whose scan cannot be registered are left out and counted. Poses of the log predict the motion.
"""

import logging
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import CalibrationError, RecordingError
from hickory_stream.geometry.rigid import compose, invert, no_directions, turned_directions
from hickory_stream.ports import NotRegistered, Registered, Source, SourceAround
from hickory_stream.poses.camera_odometry import CameraOdometry
from hickory_stream.poses.choose import make_odometry
from hickory_stream.poses.depth_scan import scan_of_depth
from hickory_stream.poses.odometry_config import MethodName, Sensor
from hickory_stream.poses.upright import LevelledPoses, up_in
from hickory_stream.records import Frame, RawFrame, Scan, SourceInfo
from players.logs.log_source import LogSource
from players.options import OdometryChoice
from players.poses.interpolation import row_of_pose, world_from_down
from players.poses.tf import FrameTree
from players.poses.tracks import GrowingTrack

_Posed = tuple[RawFrame, NDArray[np.float64], NDArray[np.float64], Frame | None]
"""A frame, its pose (4, 4), `Frame.degenerate`, and what was decoded of it, if anything was."""

logger = logging.getLogger(__name__)

_CAMERA_UP = np.array([0.0, -1.0, 0.0])
_MAX_GAP_NS = 500_000_000


class OdometrySource(SourceAround):
    """A `Source` that plays another one with estimated poses."""

    def __init__(self, source: Source, sensor: Sensor, method: MethodName | None = None) -> None:
        """Connect the sensor to the camera.

        Raises `RecordingError`: LiDAR was asked for, and there is none; `CalibrationError`: neither TF nor the profile
        connects it to the camera; `ModelError`: the method's library is not installed.
        """
        super().__init__(source)
        self.sensor = sensor
        self._method = method
        self._counts: Counter[str] = Counter()
        self._resumes_at: tuple[int, NDArray[np.float64]] | None = None
        self._name = make_odometry(sensor, method).name
        self._predicts = isinstance(source, LogSource)
        self._lidar = _lidar_of(source) if sensor == "lidar" else None

    @property
    def info(self) -> SourceInfo:
        """The info of the other source, with estimated poses."""
        info = self._source.info
        streams = {**dict(info.streams), "pose": f"odometry: {self.poses_by}"}
        if self._lidar is not None:
            streams["lidar"], streams["lidar_to_camera"] = self._lidar[0], self._lidar[2]
        return replace(info, streams=tuple(streams.items()))

    @property
    def poses_by(self) -> str:
        """The names of the method and the sensor."""
        return f"{self._name} on {self.sensor}"

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames that have a pose, from the beginning; each call repeats the estimation."""
        counts = self._counts = Counter()
        placed = self._by_lidar(counts) if self._lidar is not None else self._by_depth(counts)
        index = 0
        for raw, world_from_camera, degenerate, decoded in self._handed_over(placed):
            yield replace(
                raw,
                index=index,
                world_from_camera=world_from_camera,
                decode=partial(_frame_of, raw, decoded, index, world_from_camera, degenerate),
                after_from_before=None,
                is_posed=True,
            )
            index += 1

    def ledger(self) -> Mapping[str, int]:
        """Return the ledger of the other source, and the counts of odometry.

        `odometry_lost` frames have no pose; `odometry_degenerate` scans do not constrain all directions.
        """
        return {**self._source.ledger(), **{name: count for name, count in sorted(self._counts.items()) if count}}

    def continue_from(self, stamp_ns: int, world_from_camera: NDArray[np.float64]) -> None:
        """Continue after the frame of this stamp, with the pose (4, 4) that the journal has of it."""
        self._resumes_at = (stamp_ns, world_from_camera)

    def _handed_over(self, placed: Iterator[_Posed]) -> Iterator[_Posed]:
        # On the same type of processor both world frames are equal to the last bit, and nothing changes.
        journaled_from_estimated: NDArray[np.float64] | None = None
        for raw, pose, degenerate, decoded in placed:
            world_from_camera = pose
            if self._resumes_at is not None and raw.stamp_ns == self._resumes_at[0]:
                journaled = self._resumes_at[1]
                is_same = journaled.tobytes() == np.ascontiguousarray(pose).tobytes()
                journaled_from_estimated = None if is_same else compose(journaled, invert(pose))
            if journaled_from_estimated is not None:
                world_from_camera = compose(journaled_from_estimated, pose)
            yield raw, world_from_camera, degenerate, decoded

    def _by_depth(self, counts: Counter[str]) -> Iterator[_Posed]:
        odometry, levelled = CameraOdometry(self._method), LevelledPoses()
        results = _Results(counts, "depth")
        world_from_start: NDArray[np.float64] | None = None
        before: NDArray[np.float64] | None = None
        for raw in self._source.frames():
            try:
                frame = raw.decode()
            except RecordingError:
                counts["odometry_unreadable"] += 1
                continue
            step = compose(invert(before), raw.world_from_camera) if before is not None and raw.is_posed else None
            found = results.add(odometry.register(frame, step), raw.stamp_ns)
            if found is None:
                counts["odometry_lost"] += 1
                continue
            before = raw.world_from_camera if raw.is_posed and self._predicts else None
            if world_from_start is None:
                world_from_start = self._world_from_first(raw, scan_of_depth(frame))
            pose = levelled.placed(world_from_start, found.start_from_sensor, scan_of_depth(frame))
            yield raw, pose, found.degenerate, frame

    def _by_lidar(self, counts: Counter[str]) -> Iterator[_Posed]:
        # Poses are interpolated between sweeps; the log's poses predict the motion of a sweep.
        assert self._lidar is not None and isinstance(self._source, LogSource)
        topic, camera_from_lidar, _ = self._lidar
        lidar_from_camera = invert(camera_from_lidar)
        results, odometry = _Results(counts, topic), make_odometry("lidar", self._method)
        known, track = GrowingTrack(_MAX_GAP_NS, None), GrowingTrack(_MAX_GAP_NS, None)
        sweeps = self._source.scans(topic)
        sweep = next(sweeps, None)
        waiting: deque[RawFrame] = deque()
        last_ns: int | None = None
        degenerate = no_directions()
        world_from_start: NDArray[np.float64] | None = None

        def take(until_ns: int | None) -> None:
            nonlocal sweep, last_ns, degenerate
            while sweep is not None and (until_ns is None or sweep.stamp_ns <= until_ns):
                step = _step(known, last_ns, sweep.stamp_ns, camera_from_lidar)
                found = results.add(odometry.register(sweep, step), sweep.stamp_ns)
                if found is not None:
                    track.add(sweep.stamp_ns, row_of_pose(found.start_from_sensor))
                    last_ns = sweep.stamp_ns
                    # How the sensors lie to each other turns a direction; that they are apart hardly matters.
                    degenerate = turned_directions(camera_from_lidar, found.degenerate)
                sweep = next(sweeps, None)

        frames = self._source.frames()
        is_ended = False
        while not is_ended or waiting:
            raw = next(frames, None)
            is_ended = raw is None
            if raw is not None:
                if raw.is_posed:
                    known.add(raw.stamp_ns, row_of_pose(raw.world_from_camera))
                waiting.append(raw)
            take(None if raw is None else raw.stamp_ns)
            while waiting and (is_ended or (last_ns is not None and track.reaches(waiting[0].stamp_ns))):
                first = waiting.popleft()
                start_from_lidar = track.at(first.stamp_ns)
                if start_from_lidar is None:
                    counts["odometry_lost"] += 1
                    continue
                start_from_camera = compose(start_from_lidar, lidar_from_camera)
                if world_from_start is None:
                    world_from_first = self._world_from_first(first, scan_of_depth(first.decode()))
                    world_from_start = compose(world_from_first, invert(start_from_camera))
                yield first, compose(world_from_start, start_from_camera), degenerate, None

    def _world_from_first(self, raw: RawFrame, scan: Scan) -> NDArray[np.float64]:
        if raw.is_posed:
            return raw.world_from_camera
        up = up_in(scan, _CAMERA_UP)
        if up is None:
            self._counts["odometry_without_up"] += 1
            logger.warning(
                "the first frame, at %.3f s, shows no level surface by which the world could be put upright; its image "
                "is taken to be upright. Heights are wrong where it is not; name --pose-topic, or start elsewhere",
                raw.stamp_ns / 1e9,
            )
        return world_from_down(-(_CAMERA_UP if up is None else up))


class _Results:
    def __init__(self, counts: Counter[str], name: str) -> None:
        self._counts = counts
        self._name = name
        self._is_lost = False

    def add(self, found: Registered | NotRegistered, stamp_ns: int) -> Registered | None:
        if isinstance(found, NotRegistered):
            if not self._is_lost:
                logger.warning("odometry by %s is lost at %.3f s: %s", self._name, stamp_ns / 1e9, found.reason)
            self._is_lost = True
            self._counts["odometry_scans_lost"] += 1
            return None
        if self._is_lost:
            logger.warning("odometry by %s goes on at %.3f s", self._name, stamp_ns / 1e9)
        self._is_lost = False
        self._counts["odometry_scans"] += 1
        self._counts["odometry_degenerate"] += len(found.degenerate) > 0
        return found


def with_odometry(source: Source, choice: OdometryChoice) -> OdometrySource:
    """Return a source that estimates its poses by the named sensor or method; a method uses LiDAR, else depth.

    Raises `HickoryError`: as `OdometrySource` does.
    """
    if choice in ("lidar", "depth"):
        return OdometrySource(source, choice)
    method = choice if choice in ("small_gicp", "kiss-icp") else None
    return OdometrySource(source, "lidar" if _can_use_lidar(source) else "depth", method)


def _can_use_lidar(source: Source) -> bool:
    try:
        _lidar_of(source)
    except (RecordingError, CalibrationError):
        return False
    return True


def _lidar_of(source: Source) -> tuple[str, NDArray[np.float64], str]:
    topics = source.clouds() if isinstance(source, LogSource) else ()
    if not isinstance(source, LogSource) or not topics:
        raise RecordingError(f"{source.info.uri} has no LiDAR (sensor_msgs/PointCloud2); choose --odometry depth")
    first = next(source.scans(topics[0]), None)
    if first is None:
        raise RecordingError(f"{source.info.uri}: {topics[0]} holds no sweep that can be read")
    setup = source.setup
    chain = setup.tree.chain(setup.color_frame, first.frame) if setup.tree is not None else None
    if chain is not None and chain.is_static and (frame_from_lidar := chain.at(0)) is not None:
        camera_from_lidar = invert(setup.corrections.turned(invert(frame_from_lidar)))
        return topics[0], camera_from_lidar, f"TF of the log: {' <- '.join(chain.frames)}"
    if setup.rig is not None and setup.rig.lidar:
        linked = FrameTree(setup.rig.links).chain(setup.rig.color, setup.rig.lidar)
        if linked is not None and (frame_from_lidar := linked.at(0)) is not None:
            camera_from_lidar = invert(setup.corrections.turned(invert(frame_from_lidar)))
            return topics[0], camera_from_lidar, f"profile: {' <- '.join(linked.frames)}"
    raise CalibrationError(
        f"{source.info.uri}: no static transform from the LiDAR's frame {first.frame} to the camera's "
        f"{setup.color_frame}. Record /tf_static, name a --profile with `lidar` under [rig], or choose --odometry depth"
    )


def _step(
    known: GrowingTrack, last_ns: int | None, now_ns: int, camera_from_lidar: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    before = known.at(last_ns) if last_ns is not None else None
    now = known.at(now_ns)
    if before is None or now is None:
        return None
    return compose(invert(camera_from_lidar), invert(before), now, camera_from_lidar)


def _frame_of(
    raw: RawFrame, decoded: Frame | None, index: int, pose: NDArray[np.float64], degenerate: NDArray[np.float64]
) -> Frame:
    return replace(decoded or raw.decode(), index=index, world_from_camera=pose, degenerate=degenerate)
