"""Opening of a log: roles of topics, registration of depth, and the poses of the camera.

Only the beginning is read: up to images of both topics, their calibrations, and poses connected to the camera.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import CalibrationError, NoPosesError, RecordingError
from hickory_stream.geometry.rigid import from_rotation_translation
from players.logs import topic_discovery as discovery
from players.logs.containers import Log, Topic, UnreadableMessageError, deserialize, first_messages
from players.logs.log_setup import LogSetup
from players.logs.log_source import LogSource
from players.logs.robots import other_robots
from players.logs.synchronizer import default_tolerance_ns
from players.logs.time_base import choose_clock
from players.logs.video_log import packet_of, with_video
from players.messages.calibration import Lens, has_shape, lens_of, scaled
from players.messages.depth_registration import Registration
from players.messages.images import (
    LogImage,
    Probe,
    check_color_encoding,
    check_decodes,
    check_depth_encoding,
    check_depth_unit,
    codec_of,
    color_of,
    depth_of,
    image_of,
    kind_of,
)
from players.messages.records import COMPRESSED_IMAGE, IMAGE, TF, VIDEOS
from players.options import DEFAULT_MAX_POSE_GAP_NS, NO_TOPIC, SourceOptions
from players.poses.camera_poses import UNPOSED, PosePlan, PoseReader, PoseStream, own_parent_text, plan_poses
from players.poses.pose_file import read_pose_file
from players.poses.tf import FrameTree
from players.profile import Profile, guess_profile, load_profile, profiles_with_robots, robots_in

_PATIENCE_NS = 10_000_000_000
"""How much more of the log is read for topics without a message, once everything needed has been found."""

_HORIZON_NS = 300_000_000_000
"""How much of the log is read to find the links that are needed: a recording in which they come later is refused."""

Contents = Mapping[str, discovery.Content]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Opening:
    """The contents of the beginning of a log; `plan` is None while no pose is connected to the camera."""

    log: Log
    options: SourceOptions
    profile: Profile
    is_profile_guessed: bool
    topics: discovery.ImageTopics
    color: Probe
    depth: Probe
    reader: PoseReader
    infos: tuple[str | None, str | None]
    plan: PosePlan | None
    is_pose_named: bool
    pose_file: tuple[list[int], list[list[float]]] | None
    #: The topics of other robots.
    others: frozenset[str] = frozenset()

    @property
    def max_gap_ns(self) -> int:
        """The widest gap between poses."""
        return self.options.max_pose_gap_ns or self.profile.max_pose_gap_ns or DEFAULT_MAX_POSE_GAP_NS


def choose_profile(topics: Sequence[Topic], options: SourceOptions) -> tuple[Profile, bool]:
    """Return the profile that was named or fits the topics (empty if none does), and whether it was guessed."""
    if options.profile == "none":
        profile, is_guessed = Profile(), False
    elif options.profile is not None:
        profile, is_guessed = load_profile(options.profile, topics, options.robot), False
    else:
        guessed = guess_profile(topics, options.robot)
        profile, is_guessed = guessed or Profile(), guessed is not None
    if options.robot is not None:
        _check_robot(options.robot, profile, topics)
    return profile, is_guessed


def _check_robot(robot: str, profile: Profile, topics: Sequence[Topic]) -> None:
    if not profile.has_robots:
        kind = f"the profile {profile.name}" if profile.name else "this kind of log"
        raise CalibrationError(
            f"found --robot {robot}, but {kind} knows no robots; leave it out, or name a profile that does "
            f"(--profile {' or '.join(profiles_with_robots())})"
        )
    if not {name for names in profile.topics.values() for name in names} & {topic.name for topic in topics}:
        found = ", ".join(robots_in(topics, profile)) or "none"
        raise CalibrationError(f"found --robot {robot}, of which the log has no topics; robots in it: {found}")


def open_log(log: Log, options: SourceOptions, *, contents: Contents | None = None) -> LogSource:
    """Return the source of a log; `contents` of its images are those of a live one, which arrives while it is read.

    Raises `RecordingError`: colour, depth or poses are missing, or never meet in time; `CalibrationError`: intrinsics
    or the frames between pose and camera are missing.
    """
    opening, is_live = read_opening(log, options, contents), contents is not None
    log = opening.log
    color_image, depth_image = opening.color.first, opening.depth.first
    for probe in (opening.color, opening.depth):
        if probe.first is None:
            raise RecordingError(
                f"{log.path}: {probe.topic.name} ({probe.topic.type_name}) holds no image; found "
                f"{probe.num_unreadable} messages that cannot be read"
                + (f" ({probe.error})" if probe.error else "")
                + _damage_of(log)
            )
    assert color_image is not None and depth_image is not None
    check_color_encoding(color_image)
    check_depth_encoding(depth_image)
    check_decodes(opening.color, color_of, "--color-topic")
    check_decodes(opening.depth, depth_of, "--depth-topic")
    check_depth_unit(opening.depth, opening.profile.depth_units_per_m)
    color_info = _info_topic(opening, opening.topics.color, color_image, opening.infos[0], "--color-info-topic")
    color_lens = _lens(opening.reader, color_info, opening.color)
    depth_info, depth_lens = _depth_lens(opening, color_info, color_lens)
    color_from_depth, extrinsics = _color_from_depth(opening, color_image.frame, depth_image.frame)
    depth_ends = (color_image.frame, depth_image.frame) if extrinsics.startswith("TF") else None
    estimates = options.estimates_poses
    try:
        plan = opening.plan or (UNPOSED if estimates else _plan(opening, color_image.frame))
    except (CalibrationError, NoPosesError) as error:
        if reason := _unreadable(opening):
            raise RecordingError(f"{error}{reason}") from error
        raise
    clock, clock_reason = choose_clock(options.clock, opening.color, opening.depth, opening.reader, plan)
    stamps = [probe.stamps_ns if clock == "header" else probe.log_ns for probe in (opening.color, opening.depth)]
    tolerance_ns = options.sync_tolerance_ns
    if tolerance_ns is None:
        tolerance_ns = opening.profile.sync_tolerance_ns
    if tolerance_ns is None:
        tolerance_ns = default_tolerance_ns(*stamps)
    if opening.pose_file is not None:
        clock_reason += f"; poses of {options.pose_file}"
    used = {plan.stream.topic} if plan.stream is not None else set()
    used |= {topic.name for topic in log.topics if topic.type_name in TF} - opening.others | {color_info, depth_info}
    small = [topic for topic in log.topics if topic.name in used]
    profile = opening.profile
    guess = " (guessed from the topics)" if opening.is_profile_guessed else ""
    setup = LogSetup(
        topics=opening.topics,
        small_topics=tuple(small),
        color_lens=color_lens,
        depth_lens=depth_lens,
        registration=Registration(
            depth_camera=depth_lens.camera,
            color_camera=color_lens.camera,
            color_from_depth=profile.corrections.between(color_from_depth),
        ),
        plan=plan,
        max_gap_ns=opening.max_gap_ns,
        jump_limits=profile.jump_limits,
        pose_file=opening.pose_file,
        tolerance_ns=tolerance_ns,
        uses_log_time=clock == "log",
        depth_units_per_m=profile.depth_units_per_m,
        sensor=profile.sensor,
        corrections=profile.corrections,
        has_float_depth=depth_image.encoding.strip().startswith("32FC1"),
        is_live=is_live,
        estimates_poses=estimates,
        tree=opening.reader.tree(),
        rig=profile.rig,
        color_frame=color_image.frame,
        depth_ends=depth_ends,
        findings=_findings(opening, plan),
        streams=(
            *([("profile", f"{profile.name}{guess}")] if profile.name else []),
            ("color", opening.topics.color.name),
            ("depth", opening.topics.depth.name),
            ("color_info", color_info + (f" ({color_lens.note})" if color_lens.note else "")),
            ("depth_info", depth_info + (f" ({depth_lens.note})" if depth_lens.note else "")),
            ("pose", plan.source),
            ("frames", plan.path),
            ("extrinsics", plan.extrinsics),
            ("depth_to_color", extrinsics),
            ("stamps", clock_reason),
            ("sync_tolerance", f"{tolerance_ns / 1e6:.1f} ms"),
        ),
    )
    return LogSource(log, setup)


def read_opening(log: Log, options: SourceOptions, contents: Contents | None = None) -> Opening:
    """Return the contents of the beginning of a log, whether or not they suffice to play it; `contents` as `open_log`.

    Raises `RecordingError`: there are no messages, or no topics of colour, depth or poses.
    """
    if not any(topic.num_messages != 0 for topic in log.topics):
        raise RecordingError(f"{log.path} ({log.kind}) holds no messages{_damage_of(log)}")
    own = getattr(log, "profile", None) if options.profile is None and options.robot is None else None
    profile, is_guessed = (own, False) if own is not None else choose_profile(log.topics, options)
    if contents is None:
        log = with_video(log)
        contents = contents_of(log)
    topics = discovery.choose_images(log.path, log.topics, options, profile.topics, contents)
    others = other_robots(log.path, log.topics, topics.color.name, options)
    of_robot = [topic for topic in log.topics if topic.name not in others]
    poses = [] if options.pose_file else _pose_topics(log, of_robot, options, profile)
    is_named = options.pose_topic not in (None, NO_TOPIC) or (
        bool(profile.topics.get("pose")) and any(topic.name in profile.topics["pose"] for topic in poses)
    )
    is_named = is_named and not all(topic.type_name in TF for topic in poses)
    wanted = [*poses, *discovery.tf_topics(of_robot), *discovery.camera_infos(log.topics)]
    max_gap_ns = options.max_pose_gap_ns or profile.max_pose_gap_ns or DEFAULT_MAX_POSE_GAP_NS
    reader = PoseReader(wanted, max_gap_ns, profile.jump_limits, uses_log_time=options.clock == "log")
    pose_file = None
    if options.pose_file is not None:
        pose_file = read_pose_file(options.pose_file, profile.pose_file)
        body = options.pose_frame or (profile.rig.body if profile.rig is not None else "")
        stream = PoseStream(
            topic=str(options.pose_file), type_name="file", parent="world", child=body, num_poses=len(pose_file[0])
        )
        reader.load(stream, *pose_file)
    opening = Opening(
        log=log,
        options=options,
        profile=profile,
        is_profile_guessed=is_guessed,
        topics=topics,
        color=Probe(topics.color),
        depth=Probe(topics.depth),
        reader=reader,
        infos=(None, None),
        plan=None,
        is_pose_named=is_named or pose_file is not None,
        pose_file=pose_file,
        others=others,
    )
    return _filled(opening, {topic.name for topic in wanted if topic.num_messages != 0})


def contents_of(log: Log) -> dict[str, discovery.Content]:
    """Return the content of each topic of images whose first message comes early."""
    topics = {topic.name: topic for topic in log.topics}
    return {
        name: _content(topics[name], m) for name, m in first_messages(log, (IMAGE, COMPRESSED_IMAGE, *VIDEOS)).items()
    }


def _content(topic: Topic, message: Any) -> discovery.Content:
    if topic.type_name in VIDEOS:
        packet = packet_of(message)
        return discovery.Content(codec_of(packet.encoding, packet.data), packet.frame, packet.encoding)
    image = image_of(topic, message)
    return discovery.Content(kind_of(image), image.frame)


def _pose_topics(log: Log, topics: Sequence[Topic], options: SourceOptions, profile: Profile) -> list[Topic]:
    try:
        return discovery.pose_topics(log.path, topics, options, profile.topics.get("pose", ()))
    except NoPosesError:
        if not options.estimates_poses:
            raise
        return []


def _filled(opening: Opening, wanted: set[str]) -> Opening:
    log, reader, topics = opening.log, opening.reader, opening.topics
    probes = {topics.color.name: opening.color, topics.depth.name: opening.depth}
    first_ns: int | None = None
    passed_ns = 0
    for count, message in enumerate(log.messages({*wanted, *probes})):
        probe = probes.get(message.topic)
        if probe is None:
            reader.add(message)
        else:
            # Progress is measured by the images: another bag of the log may have been recorded years later.
            first_ns = message.log_ns if first_ns is None else first_ns
            passed_ns = max(passed_ns, message.log_ns - first_ns)
            if not probe.is_full:
                _look_at(probe, message.data, message.log_ns)
        if count % 50 and count > 50:
            continue
        if passed_ns > _HORIZON_NS:
            break
        if opening.color.is_full and opening.depth.is_full and (wanted <= reader.seen or passed_ns > _PATIENCE_NS):
            opening = replace(opening, infos=_infos(opening), plan=_try_plan(opening))
            is_placed = opening.plan is not None or opening.options.estimates_poses
            if opening.infos[0] is not None and is_placed and _has_depth_info(opening):
                return opening
    reader.end()
    return replace(opening, infos=_infos(opening), plan=_try_plan(opening))


def _look_at(probe: Probe, data: object, log_ns: int) -> None:
    try:
        image = image_of(probe.topic, deserialize(probe.topic, data))
    except UnreadableMessageError as error:
        probe.num_unreadable += 1
        probe.error = probe.error or str(error)
        return
    probe.images.append(image)
    probe.stamps_ns.append(image.stamp_ns)
    probe.log_ns.append(log_ns)


def _infos(opening: Opening) -> tuple[str | None, str | None]:
    named = (opening.options.color_info_topic, opening.options.depth_info_topic)
    found = []
    for probe, name, role in zip((opening.color, opening.depth), named, ("color_info", "depth_info"), strict=True):
        listed = opening.profile.topics.get(role, ())
        found.append(_find_info(opening.reader, probe, name, listed) if probe.first is not None else None)
    return found[0], found[1]


def _find_info(reader: PoseReader, probe: Probe, name: str | None, listed: Sequence[str]) -> str | None:
    assert probe.first is not None
    if name is not None:
        return name if name in reader.infos else None
    for candidate in (*listed, *discovery.info_names(probe.topic)):
        if candidate in reader.infos:
            return candidate
    same_frame = [info for info in sorted(reader.infos) if reader.infos[info].frame == probe.first.frame]
    return same_frame[0] if len(same_frame) == 1 else None


def _has_depth_info(opening: Opening) -> bool:
    color, depth = opening.color.first, opening.depth.first
    if color is None or depth is None:
        return False
    return opening.infos[1] is not None or (color.frame == depth.frame and color.size is not None)


def _try_plan(opening: Opening) -> PosePlan | None:
    if opening.color.first is None or opening.options.pose_topic == NO_TOPIC:
        return None
    try:
        return _plan(opening, opening.color.first.frame)
    except (CalibrationError, RecordingError):
        return None


def _plan(opening: Opening, camera_frame: str) -> PosePlan:
    options, profile = opening.options, opening.profile
    return plan_poses(
        opening.log.path,
        opening.reader,
        camera_frame,
        color_topic=opening.topics.color.name,
        pose_frame=options.pose_frame,
        is_named=opening.is_pose_named,
        rig=profile.rig if options.pose_frame is None else None,
        rig_topics=(*profile.topics.get("pose", ()), *([str(options.pose_file)] if options.pose_file else [])),
        profile_name=profile.name,
    )


def _info_topic(opening: Opening, topic: Topic, image: LogImage, found: str | None, option: str) -> str:
    if found is None:
        known = opening.reader.infos
        infos = ", ".join(f"{info} (frame {known[info].frame})" for info in sorted(known)) or "none"
        options = opening.options
        asked = options.color_info_topic if option == "--color-info-topic" else options.depth_info_topic
        raise CalibrationError(
            f"{opening.log.path}: no intrinsics for {topic.name}: no CameraInfo on "
            f"{asked or ' or '.join(discovery.info_names(topic))}, nor one of frame {image.frame}; "
            f"CameraInfo topics: {infos}. Name one with {option}{_unreadable(opening)}"
        )
    return found


def _lens(reader: PoseReader, info: str, probe: Probe) -> Lens:
    is_rectified = discovery.is_rectified(probe.topic)
    return lens_of(reader.infos[info], topic=info, image_size=probe.size, is_rectified=is_rectified)


def _depth_lens(opening: Opening, color_info: str, color_lens: Lens) -> tuple[str, Lens]:
    color, depth = opening.color.first, opening.depth.first
    assert color is not None and depth is not None
    if opening.options.depth_info_topic is None and opening.infos[1] is None:
        size = opening.depth.size
        if depth.frame == color.frame and size is not None and has_shape(color_lens.camera, size):
            if size == (color_lens.camera.width, color_lens.camera.height):
                return color_info, color_lens
            note = f"scaled from colour to {size[0]}x{size[1]}"
            return color_info, replace(color_lens, camera=scaled(color_lens.camera, size), note=note)
    info = _info_topic(opening, opening.topics.depth, depth, opening.infos[1], "--depth-info-topic")
    return info, _lens(opening.reader, info, opening.depth)


def _color_from_depth(opening: Opening, color_frame: str, depth_frame: str) -> tuple[NDArray[np.float64], str]:
    tree = opening.reader.tree()
    chain = tree.chain(color_frame, depth_frame)
    if chain is not None and chain.edges and chain.is_static:
        color_from_depth = chain.at(0)
        assert color_from_depth is not None
        return color_from_depth, f"TF of the log: {' <- '.join(chain.frames)}"
    rig, name = opening.profile.rig, opening.profile.name
    if rig is not None and rig.color != rig.depth:
        linked = FrameTree(rig.links).chain(rig.color, rig.depth)
        color_from_depth = linked.at(0) if linked is not None else None
        if linked is not None and color_from_depth is not None:
            return color_from_depth, f"profile {name}: {' <- '.join(linked.frames)}"
    if color_frame == depth_frame:
        return np.eye(4), "none: depth has the colour's frame"
    if rig is not None and rig.color == rig.depth:
        return np.eye(4), f"none: profile {name} says that depth is registered"
    if opening.profile.name and any(opening.profile.color_from_depth_m):
        translation = np.array(opening.profile.color_from_depth_m)
        return from_rotation_translation(np.eye(3), translation), f"profile {name}: a translation"
    known = "; ".join([", ".join(sorted(tree.edges)) or "none", *opening.reader.harm()])
    raise CalibrationError(
        f"{opening.log.path}: no static transform from the depth's frame {depth_frame} to the colour's {color_frame}; "
        f"frames of TF: {known}. Record /tf_static, name a --profile with the links of this camera, or name depth that "
        "is registered to the colour with --depth-topic"
    )


def _findings(opening: Opening, plan: PosePlan) -> tuple[str, ...]:
    streams = opening.reader.streams() if opening.options.pose_frame is None else ()
    texts = [own_parent_text(stream) for stream in streams if stream.is_own_parent and stream != plan.stream]
    if opening.others:
        texts.append(f"{', '.join(sorted(opening.others))} are left out: they lie in the namespace of another robot")
    return tuple(texts)


def _unreadable(opening: Opening) -> str:
    number = opening.reader.fates["unreadable_message"]
    return f"; {number} messages cannot be read, the first: {opening.reader.error}" if number else ""


def _damage_of(log: Log) -> str:
    if not len(log.flaws):
        return ""
    first = next(iter(log.flaws))
    return (
        f"; {len(log.flaws)} places of the log are damaged, the first at byte {first.offset} of {first.file}: "
        f"{first.what}. `hickory-stream doctor` lists them"
    )
