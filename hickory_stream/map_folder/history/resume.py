"""Resuming of an interrupted run: killed, stopped, or ended by an error.

A playback continues after its last complete step, to the same map as an uninterrupted one. A live run, whose frames are
gone, or a run with seeks is saved as of its last step.
"""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hickory_stream.base.confined import OutsideError, whole_number
from hickory_stream.config import MapperConfig
from hickory_stream.errors import MapFolderError, RecordingError
from hickory_stream.journal.format import JOURNAL
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.step import FramePose, OpenJob, Step, StepKind
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.map_folder.history.core_replay import Replay, mesh_names
from hickory_stream.map_folder.history.recorded_config import recorded_config
from hickory_stream.map_folder.history.registration_history import RegistrationHistory, registration_history
from hickory_stream.map_folder.manifest import Manifest, read_manifest
from hickory_stream.map_folder.views import crop_files
from hickory_stream.map_folder.writer import MapFolder, reopen_map_folder
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.rules.keyframes import Keyframe
from hickory_stream.poses.keyframe_registration import NUM_RECENT
from hickory_stream.records import SourceInfo


@dataclass(frozen=True, kw_only=True, slots=True)
class Position:
    """Reading continues after this position: the frame `last_index` of a round, whose last keyframe was `keyframe`."""

    round_index: int = 0
    first_index: int = 0
    last_index: int = -1
    keyframe: Keyframe | None = None
    last_ns: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ResumePoint:
    """The state of an interrupted run: core, last step, pending shape jobs."""

    core: MapperCore
    step: Step
    position: Position
    open_jobs: tuple[OpenJob, ...]
    mesh_names: tuple[str, ...]
    last_frame: FramePose
    #: None without registered keyframes.
    registration: RegistrationHistory | None = None


def resume_point_of(journal: Journal, config: MapperConfig) -> ResumePoint | None:
    """Return the state of an interrupted run, None before its first keyframe.

    Raises `MapFolderError`: the journal does not fit this version.
    """
    if len(journal) == 0:
        return None
    last = len(journal) - 1
    replay = Replay(journal, config.mapping, reads_later=True)
    replay.seek(last)
    step = journal.step(last)
    frames = step.frames
    index = last
    while not frames:
        index -= 1
        frames = journal.step(index).frames
    frame = frames[-1]
    keyframe = Keyframe(stamp_ns=frame.stamp_ns, world_from_camera=frame.world_from_camera)
    return ResumePoint(
        core=replay.core,
        step=step,
        position=Position(
            round_index=step.round_index,
            first_index=step.first_index,
            last_index=frame.index,
            keyframe=keyframe if step.kind is StepKind.KEYFRAME else None,
            last_ns=frame.stamp_ns,
        ),
        open_jobs=tuple(replay.open_jobs.values()),
        mesh_names=tuple(sorted(mesh_names(journal))),
        last_frame=frame,
        registration=registration_history(journal, len(journal), num_recent=NUM_RECENT),
    )


def check_interrupted(path: Path) -> Manifest:
    """Return the manifest of an interrupted map. Raises `MapFolderError`: there is no map, or its run had finished."""
    manifest = read_manifest(path)
    if manifest.finished_cleanly:
        raise MapFolderError(f"{path} is finished: there is nothing to resume; `inspect` shows it")
    return manifest


def reopen(
    path: Path, info: SourceInfo, config: MapperConfig, extractor: str
) -> tuple[MapFolder, JournalWriter, ResumePoint | None]:
    """Return the folder of a playback to continue, its journal, and its state (None: from the beginning).

    Raises `MapFolderError`: there is no map, nothing to continue, or it cannot be continued, e.g. with another feature
    extractor; `RecordingError`: the source differs from the map's.
    """
    manifest = check_interrupted(path)
    if manifest.run.get("mode") != "playback":
        raise MapFolderError(f"{path} is the map of a live run, whose frames are gone; `resume` saves what it had")
    try:
        whole_number(manifest.run.get("loops"), "loops", 1)
    except OutsideError as error:
        raise MapFolderError(f"{path}: its manifest is damaged: {error}; play the log again") from error
    if manifest.source.get("identity") != info.identity:
        raise RecordingError(
            f"{info.uri} is not the log that {path} was made of ({manifest.source.get('uri')}); give that one"
        )
    if manifest.extractor not in ("", extractor):
        raise MapFolderError(
            f"{path} has features of {manifest.extractor}, not of {extractor}; resume it with that one"
        )
    if was_sought(path):
        raise MapFolderError(
            f"{path}: somebody sought in the log, so that it is not known which frames are left; "
            "`hickory-stream resume` saves what it had, or play the log again"
        )
    folder = reopen_map_folder(path)
    try:
        with Journal(path) as journal:
            journal.cut_to_resumable()
            continued = resume_point_of(journal, config)
            if continued is not None:
                _check_views(folder, continued)
            return folder, JournalWriter(path, flush_s=config.journal.flush_s, continued=journal), continued
    except BaseException:
        folder.close()
        raise


def was_sought(path: Path) -> bool:
    """Return whether a run had seeks, so that it cannot be continued. Raises `MapFolderError`: no readable journal."""
    with Journal(path) as journal:
        # The count never falls: if the last step has none, no earlier one has.
        with suppress(MapFolderError):
            if len(journal) == 0 or journal.step(len(journal) - 1).num_seeks == 0:
                return False
        journal.cut_to_resumable()
        return len(journal) > 0 and journal.step(len(journal) - 1).num_seeks > 0


def save_live(path: Path) -> str:
    """Save the map of a killed run as of its last complete step; return the digest.

    Raises `MapFolderError`: there is no map, nothing to save, or the disk refused.
    """
    check_interrupted(path)
    config = recorded_config(path)
    folder = reopen_map_folder(path)
    try:
        with Journal(path) as journal:
            journal.cut_to_resumable()
            continued = resume_point_of(journal, config)
            JournalWriter(path, flush_s=config.journal.flush_s, continued=journal).close()
        if continued is not None:
            for name in continued.mesh_names:
                folder.keep_shape(name)
            folder.save(continued.core.snapshot())
        return folder.finish(finished_cleanly=False, is_reproducible=False).digest or ""
    finally:
        folder.close()


def _check_views(folder: MapFolder, continued: ResumePoint) -> None:
    for tracked in continued.core.snapshot().objects:
        for view in tracked.views:
            if not crop_files(folder.views, view.name)[-1].is_file():
                raise MapFolderError(
                    f"{folder.path} lacks views/{view.name}, which {JOURNAL} tells of: the power failed before it "
                    "reached the disk; play the log again"
                )
