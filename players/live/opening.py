"""Opening of a live route: wait until all needed topics have come, report the missing ones, then map.

An attempt opens the messages so far as a log. It is repeated until it succeeds or patience ends.
"""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

from hickory_stream.errors import InputError, RecordingError
from hickory_stream.ports import SourceAround
from hickory_stream.records import RawFrame, SourceInfo
from players.doctor.motion_mends import watched
from players.live.inbox import Inbox
from players.live.live_log import LiveLog
from players.live.recorder import Recorder
from players.live.routes import is_recording, route_of
from players.live.status import ROLES, LiveStatus, status_of
from players.live.transport import LiveSource, ReturnLink
from players.logs.containers import Log, Topic
from players.logs.log_opening import Contents, choose_profile, contents_of, open_log
from players.logs.log_source import LogSource
from players.logs.message_account import Account, TopicAccount
from players.logs.robots import other_robots
from players.logs.topic_discovery import camera_infos, choose_images, is_neither, pose_topics, tf_topics
from players.logs.video_log import with_video
from players.messages.records import COMPRESSED_IMAGE, IMAGE, VIDEOS
from players.options import SourceOptions

DEFAULT_PATIENCE_S = 60.0
DEFAULT_ATTEMPT_S = 2.0

_IMAGES = (IMAGE, COMPRESSED_IMAGE, *VIDEOS)
_QUIET_S = 0.5
_BETWEEN_S = 0.25


class LiveMapSource(SourceAround):
    """The `Source` of an opened live route; `frames` can be called once."""

    def __init__(self, route: LiveSource, log: LiveLog, source: LogSource, recorder: Recorder | None = None) -> None:
        super().__init__(source)
        log.roles = {name: role for role, name in source.setup.streams if role in ROLES}
        self._route = route
        self._recorder = recorder
        self._log = log
        self._log_source = source
        self._warnings: list[str] = []

    @property
    def info(self) -> SourceInfo:
        """The diagnosis on opening; each session has its own identity."""
        session = f"{self._log.path}\0{self._source.info.start_ns}"
        return replace(self._source.info, identity=hashlib.sha256(session.encode()).hexdigest())

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames as they arrive, until the route ends or `interrupt` is called."""
        self._log.begin()
        return watched(self._log_source, self._source.frames(), self._warnings)

    def ledger(self) -> Mapping[str, int]:
        """Return the counts of the messages, and how often the robot's clock was set."""
        steps = max(self._log.clock_offset.num_steps, self._log_source.num_clock_steps)
        return {**self._source.ledger(), **({"clock_steps": steps} if steps else {})}

    def account(self) -> Account:
        """Return the account of every received message."""
        kept: Account = self._log_source.account()
        left = self._log.left()
        entries = [self._entry(entry, left[entry.topic]) for entry in kept.topics]
        for name in sorted(self._log.hidden):
            number = self._log.declared()[name]
            entries.append(TopicAccount(topic=name, declared=number, not_needed=number))
        findings = (*kept.findings, *self._warnings)
        return replace(kept, topics=tuple(entries), explanation=self._log.inbox.end_reason, findings=findings)

    def status(self) -> LiveStatus:
        """Return the current status of the route and its topics."""
        return status_of(self._route, self._log)

    @property
    def return_link(self) -> ReturnLink | None:
        """The way back over the same route; None without one (a pipe)."""
        return self._route if isinstance(self._route, ReturnLink) else None

    @property
    def odom_frame(self) -> str:
        """The frame of the robot's poses, "" with a pose file."""
        return self._log_source.setup.plan.path.partition(" <- ")[0]

    @property
    def has_ended(self) -> bool:
        """Whether no more messages are accepted."""
        return self._log.inbox.is_closed

    def interrupt(self) -> None:
        """End the frames."""
        self._log.end()

    def close(self) -> None:
        """Close the route and the recording."""
        self._log.end()
        self._route.stop()
        if self._recorder is not None:
            self._recorder.close()

    def _entry(self, entry: TopicAccount, num_left: int) -> TopicAccount:
        arrived = self._log.inbox.arrivals.get(entry.topic)
        dropped = {fate: n for fate, n in arrived.fates.items() if fate != "lost"} if arrived is not None else {}
        not_needed = max(0, entry.not_needed - sum(dropped.values()))
        not_played = 0 if entry.not_needed else num_left
        return replace(entry, not_needed=not_needed, not_played=not_played, rejected={**entry.rejected, **dropped})


def open_live(
    uri: str,
    options: SourceOptions | None = None,
    *,
    patience_s: float = DEFAULT_PATIENCE_S,
    attempt_s: float = DEFAULT_ATTEMPT_S,
    most_s: float | None = None,
    report: Callable[[str], None] = lambda text: None,
    recorder: Recorder | None = None,
    route: LiveSource | None = None,
    inbox: Inbox | None = None,
) -> LiveMapSource:
    """Return the source of a live route as soon as colour, depth, calibration and poses have come.

    `patience_s` limits the wait; announced but silent topics are awaited for `attempt_s` after the first images.
    `report` receives what is missing, whenever that changes. Frames end after `most_s`. `recorder` receives all
    messages and is closed with the source. `route` and `inbox` replace those of the address.

    Raises `RecordingError`: the address is wrong, the route has ended, or a topic is missing when patience ends;
    `CalibrationError`: intrinsics or extrinsics are missing then, or contradict the images.
    """
    options = options or SourceOptions()
    _check_poses_are_heard(uri, options)
    route = route or route_of(uri)
    inbox = inbox or Inbox(tap=recorder.take if recorder is not None else None)
    log = LiveLog(route, inbox, most_s=most_s, loses_nothing=is_recording(uri))
    try:
        route.start(log.inbox)
        source = _opened(route, log, options, _Patience(patience_s, attempt_s), report)
    except BaseException:
        log.end()
        route.stop()
        if recorder is not None:
            recorder.close()
        raise
    return LiveMapSource(route, log, source, recorder)


def _check_poses_are_heard(uri: str, options: SourceOptions) -> None:
    for option, value, usual in (
        ("--odometry", options.odometry, ("auto", "topic")),
        ("--extrinsics", options.extrinsics, ("log",)),
    ):
        if value not in usual:
            raise RecordingError(
                f"found {option} {value} for {uri}, expected {' or '.join(usual)}: poses are estimated from logs only; "
                "record the robot (--record) and play that"
            )


class _Patience(NamedTuple):
    most_s: float
    attempt_s: float


def _opened(
    route: LiveSource, log: LiveLog, options: SourceOptions, patience: _Patience, report: Callable[[str], None]
) -> LogSource:
    ends_s = time.monotonic() + patience.most_s
    reported = ""
    while True:
        is_over = log.inbox.is_over  # before the attempt: it may be the last one that can succeed
        try:
            seen, contents = subscribe(route, log, options)
            log.attempt(max(0.0, min(patience.attempt_s, ends_s - time.monotonic())))
            return open_log(seen, options, contents=contents)
        except InputError as error:
            reason = _missing(route, log, error)
            if is_over or log.inbox.end_reason:
                raise type(error)(log.inbox.end_reason or f"{error}; the stream has ended") from error
            if time.monotonic() >= ends_s:
                waited = f"waited {patience.most_s:g} s for {log.path}"
                raise type(error)(f"{reason}; {waited}: `hickory-stream doctor {log.path}` shows its topics") from error
        if reason != reported:
            report(f"waiting: {reason}")
            reported = reason
        log.idle(_BETWEEN_S)


def subscribe(route: LiveSource, log: LiveLog, options: SourceOptions) -> tuple[Log, Contents]:
    """Subscribe to the topics that mapping needs, once announcements pause; return the log so far, with its images.

    Names choose the first topics. Where the images of these have other roles, all topics of images are looked at.

    Raises `RecordingError`: colour, depth or poses are not announced; `CalibrationError`: unknown profile or robot.
    """
    log.idle(_BETWEEN_S)
    while not log.inbox.is_quiet(_QUIET_S) and not log.inbox.is_over:
        log.idle(_BETWEEN_S)
    log.hidden = frozenset()
    topics = log.topics
    if not topics:
        raise RecordingError(f"{log.path} has announced no topics")
    profile, _ = choose_profile(topics, options)
    seen = with_video(log)
    contents = contents_of(seen)
    is_sure = False
    try:
        images = choose_images(
            log.path, [_as_image(t, contents) for t in seen.topics], options, profile.topics, contents
        )
        kinds = [(role, contents[t.name].kind) for role, t in images._asdict().items() if t.name in contents]
        is_sure = all(kind in (role, "") for role, kind in kinds)
        log.hidden = other_robots(log.path, topics, images.color.name, options)
        listed = profile.topics.get("pose", ())
        poses = [] if options.pose_file else pose_topics(log.path, log.topics, options, listed)
    finally:
        # Announced topics are subscribed to even if others are missing.
        looked_at = [] if is_sure else [t for t in topics if t.type_name in _IMAGES and not is_neither(t)]
        small = {topic.name for topic in [*tf_topics(log.topics), *camera_infos(topics), *looked_at]}
        route.subscribe(small)
    wanted = small | {topic.name for topic in (*poses, images.color, images.depth)}
    log.roles = dict.fromkeys((topic.name for topic in poses), "pose")
    log.roles |= {images.color.name: "color", images.depth.name: "depth"}
    route.subscribe(wanted)
    log.want(wanted)
    return with_video(log), contents


def _as_image(topic: Topic, contents: Contents) -> Topic:
    # Video tells its encoding with its first message.
    return replace(topic, type_name=IMAGE) if topic.type_name in VIDEOS and topic.name not in contents else topic


def _missing(route: LiveSource, log: LiveLog, error: InputError) -> str:
    # A route that is down, and may come back, explains everything else.
    health = route.health()
    return health.problem if health.problem and not health.is_connected and not log.inbox.is_closed else str(error)
