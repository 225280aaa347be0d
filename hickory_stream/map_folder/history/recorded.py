"""Observations and decisions of a run, keyframe by keyframe, from its journal."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import MapFolderError
from hickory_stream.events import FrameObserved
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import compose, invert
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.step import FramePose, Step, StepKind, Told
from hickory_stream.map_folder.history.core_replay import Replay
from hickory_stream.map_folder.history.recorded_config import known_config
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.records import CoarseFrame, Decision, MapSnapshot


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RecordedKeyframe:
    """A keyframe as the core received it; `number` counts from 0."""

    number: int
    camera: Camera
    observed: FrameObserved
    #: (4, 4), from the observation's world to the finished map's.
    map_from_odometry: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "map_from_odometry", np.float64, (4, 4))

    @property
    def odometry_from_map(self) -> NDArray[np.float64]:
        """The inverse (4, 4)."""
        return invert(self.map_from_odometry)

    @property
    def coarse(self) -> CoarseFrame:
        """Its reduced depth and structure; raises `MapFolderError` if the journal has none."""
        if self.observed.coarse is None:
            raise MapFolderError(f"the journal has no depth of frame {self.observed.frame_index}: play the log again")
        return self.observed.coarse


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RecordedStep:
    """A step of a run: what the journal says, with the keyframe, None at the end of the run."""

    step: Step
    keyframe: RecordedKeyframe | None
    decisions: tuple[Decision, ...]


def recorded_steps(path: Path, final: MapSnapshot) -> Iterator[RecordedStep]:
    """Yield the steps of a map folder's run; `final` gives the final poses of submaps.

    Raises `MapFolderError`: there is no journal, or it is damaged or of another version.
    """
    places = {submap.id: submap.world_from_submap for submap in final.submaps}
    with Journal(path) as journal:
        for entry in journal.entries():
            told = entry.told or Told(decisions=(), submap_id=0)
            observed = next((event for event in entry.events if isinstance(event, FrameObserved)), None)
            keyframe: RecordedKeyframe | None = None
            if observed is not None and entry.step.kind is StepKind.KEYFRAME:
                keyframe = RecordedKeyframe(
                    number=entry.step.num_keyframes - 1,
                    camera=entry.step.camera,
                    observed=observed,
                    map_from_odometry=places.get(told.submap_id, np.eye(4)),
                )
            yield RecordedStep(step=entry.step, keyframe=keyframe, decisions=told.decisions)


def final_snapshot(path: Path) -> MapSnapshot:
    """Return the map of a folder; of an unfinished run, by its journal.

    Raises `MapFolderError`: there is no map, or it is damaged or of another version.
    """
    saved = open_map(path, warns=False)
    if saved.manifest.finished_cleanly:
        return saved.snapshot
    with Journal(path) as journal:
        if len(journal) == 0:
            return saved.snapshot
        replay = Replay(journal, known_config(path).mapping)
        replay.seek(len(journal) - 1)
        return replay.snapshot()


def corrected_trajectory(path: Path, at: MapSnapshot | None = None) -> dict[int, NDArray[np.float64]]:
    """Return the camera's pose (4, 4) in the map for the stamps of all frames, in order; `at`: of an earlier moment.

    Keyframes lie where the map has them; frames after them get the last correction. Of equal stamps the last counts.

    Raises `MapFolderError`: there is no journal, or it is damaged or of another version.
    """
    poses: dict[int, NDArray[np.float64]] = {}
    map_from_raw = np.eye(4)
    for recorded in recorded_steps(path, final_snapshot(path) if at is None else at):
        frames, keyframe = recorded.step.frames, recorded.keyframe
        if at is not None and recorded.step.stamp_ns > at.stamp_ns:
            break
        if recorded.step.goes_back_to is not None:
            first_ns = min((frame.stamp_ns for frame in frames), default=recorded.step.stamp_ns)
            poses = {stamp_ns: pose for stamp_ns, pose in poses.items() if stamp_ns < first_ns}
        for frame in frames:
            if keyframe is not None and frame is frames[-1]:
                pose = compose(keyframe.map_from_odometry, keyframe.observed.world_from_camera)
                map_from_raw = compose(pose, invert(frame.world_from_camera))
            poses[frame.stamp_ns] = compose(map_from_raw, frame.world_from_camera)
    return dict(sorted(poses.items()))


def frame_indices(path: Path) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices of the keyframes, and of all frames, both sorted.

    Raises `MapFolderError`: there is no journal, or it is damaged or of another version.
    """
    keyframes: set[int] = set()
    frames: set[int] = set()
    with Journal(path) as journal:
        for index in range(len(journal)):
            step = journal.step(index)
            frames |= {frame.index for frame in step.frames}
            if step.kind is StepKind.KEYFRAME and step.frames:
                keyframes.add(step.frames[-1].index)
    return np.array(sorted(keyframes), dtype=np.int64), np.array(sorted(frames), dtype=np.int64)


def frame_pose(path: Path, frame: int) -> tuple[Camera, FramePose]:
    """Return the camera of a frame, and its stamp and pose, as the odometry had it.

    Raises `LookupError`: the run has no such frame; `MapFolderError`: there is no journal, or it is damaged or of
    another version.
    """
    with Journal(path) as journal:
        for index in range(len(journal) - 1, -1, -1):
            step = journal.step(index)
            for pose in step.frames:
                if pose.index == frame:
                    return step.camera, pose
    raise LookupError(f"no frame {frame}")
