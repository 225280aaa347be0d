"""The verdicts of `doctor`: silence on cuts of sound logs, faults that were put into them, empty maps, and its time."""
# A cut is a piece of a log; a fault changes its depth, colour, poses or calibration. A verdict is right if it names the
# fault with a value whose interval holds the truth. Cuts depend on the seed: what is tuned is tuned on another one.

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from hickory_stream.errors import RecordingError
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert
from hickory_stream.poses.hand_eye import FLU_FROM_OPTICAL
from hickory_stream.records import Frame, RawFrame, SourceInfo
from hickory_stream.worlds.recording import make_recording
from players import open_source
from players.doctor.diagnosis import Diagnosis, examine_frames
from players.messages.depth_registration import Registration, register_depth
from tools.benchmarks.common.figures import Figure, Options, figure, share
from tools.benchmarks.foreign.logs import foreign_log, worlds_folder
from tools.benchmarks.logs import doctor_logs
from tools.worlds.recording_config import RecordingConfig

Frames = Sequence[Frame]
Fault = Callable[[Frames, np.random.Generator], tuple[Frames, Callable[[Diagnosis], bool]]]

_DEMO = Path("recordings/demo.mcap")
_ROOMS = (("room", 11), ("apartment", 5), ("outdoor", 3))
_SECONDS = 24.0
# What lies in the geometry is seen from several places only.
_FAULTY_S = {"bias": 12.0, "link": 12.0}
_LENGTHS_S = (2.0, 3.0, 5.0, 8.0, 15.0, np.inf)
_CASES, _QUICK_CASES = 100, 8
_PARTS = ("sound", "faults", "logs")


@dataclass(frozen=True)
class Cut:
    """A source of frames of a longer one."""

    content: Sequence[RawFrame]

    @property
    def info(self) -> SourceInfo:
        first, last = self.content[0], self.content[-1]
        return SourceInfo(
            uri="memory:cut", kind="cut", identity="cut", camera=first.camera, num_frames=len(self.content),
            start_ns=first.stamp_ns, end_ns=last.stamp_ns, streams=(),
        )  # fmt: skip

    def frames(self) -> Iterator[RawFrame]:
        return (replace(raw, index=i) for i, raw in enumerate(self.content))

    def ledger(self) -> dict[str, int]:
        return {"frames": len(self.content)}

    def close(self) -> None:
        pass


def examined(content: Sequence[RawFrame]) -> Diagnosis:
    """Return the diagnosis of a cut."""
    found = Diagnosis(uri="cut")
    examine_frames(found, Cut(content), {})
    return found


def _of_memory(frames: Frames) -> list[RawFrame]:
    return [
        RawFrame(
            index=i, stamp_ns=f.stamp_ns, camera=f.camera, world_from_camera=f.world_from_camera, decode=lambda f=f: f  # type: ignore[misc]
        )
        for i, f in enumerate(frames)
    ]  # fmt: skip


def measure(options: Options) -> list[Figure]:
    """Return the figures of the parts `sound`, `faults` and `logs`; `--scenes` names further sound logs."""
    parts = set(options.only or _PARTS)
    if parts - set(_PARTS):
        raise RecordingError(f"found --only {' '.join(options.only)}; expected {', '.join(_PARTS)}")
    number = _QUICK_CASES if options.quick else _CASES
    names, alarms, found = [*sorted(FAULTS), "calibration"], 0, 0
    with tempfile.TemporaryDirectory() as temporary:
        logs = _logs(options, Path(temporary)) if parts & {"sound", "faults"} else []
        for at, log in enumerate(logs):
            film = list(open_source(log).frames())
            for i in range(at, number, len(logs)):
                turn = i // len(logs)
                if "sound" in parts:
                    rng = np.random.default_rng([options.seed, 0, i])
                    alarms += _is_alarm(log, film, _LENGTHS_S[turn % len(_LENGTHS_S)], rng)
                if "faults" in parts:
                    # Each log has most of the faults.
                    name, rng = names[(at + turn) % len(names)], np.random.default_rng([options.seed, 1, i])
                    is_found = name in FAULTS and _is_found(log, name, film, rng)
                    found += is_found or (name not in FAULTS and doctor_logs.is_calibration_found(Path(temporary), rng))
        of = f"{number} sound cuts, from 2 s to a whole log"
        figures = [figure("doctor_false_alarms", alarms, "", "lower", of=of)] if "sound" in parts else []
        figures += share("doctor_found_fraction", found, number, "cuts with a fault") if "faults" in parts else []
        return figures + (doctor_logs.measure(options, Path(temporary)) if "logs" in parts else [])


def _logs(options: Options, folder: Path) -> list[Path]:
    logs = [_DEMO, *(path.parent / "log.mcap" if path.is_dir() else path for path in options.scenes)]
    if not options.quick:
        try:
            worlds = worlds_folder(options.worlds)
            logs += [foreign_log(worlds, world, "A", "hand").log for world in ("home", "campus")]
            logs += [kitchen] if (kitchen := worlds.parent / "data" / "redkitchen").is_dir() else []
        except RecordingError as error:
            print(f"without rooms by others: {error}", flush=True)
    for scene, seed in _ROOMS[: 1 if options.quick else None]:
        config = RecordingConfig(
            scene=scene, seed=seed + options.seed, seconds=_SECONDS, rate_hz=6.0, width=480, height=270
        )
        make_recording(config, folder, scene, caster=None)
        logs.append(folder / f"{scene}.mcap")
    return logs


def _is_alarm(log: Path, film: Sequence[RawFrame], length_s: float, rng: np.random.Generator) -> bool:
    cut = _cut(film, length_s, rng)
    found = examined(cut)
    # A cut of 2 s has too few keyframes, which is true.
    said = [text for text in (found.refusal or "", *found.problems) if text and "keyframes" not in text]
    at_s = (cut[0].stamp_ns - film[0].stamp_ns) / 1e9
    for text in said:
        print(f"  false alarm in {length_s:.0f} s of {log} from {at_s:.2f} s: {text}", flush=True)
    for text in _intervals_that_fail(found):
        print(f"  interval fails in {length_s:.0f} s of {log} from {at_s:.2f} s: {text}", flush=True)
    return bool(said)


def _intervals_that_fail(sound: Diagnosis) -> list[str]:
    motion, bias = sound.frames["motion"], sound.frames["depth_bias"]
    failing = []
    if bias is not None and abs(bias["bias_m"]) > 3 * bias["error_m"]:
        failing.append(f"bias {bias['bias_m']:.3f} +- {3 * bias['error_m']:.3f} m")
    if motion is not None and motion["scale"] is not None and abs(motion["scale"] - 1) > motion["scale_error"]:
        failing.append(f"scale {motion['scale']} +- {motion['scale_error']}")
    if motion is not None and motion["lag_s"] is not None and abs(motion["lag_s"]) > motion["lag_error_s"]:
        failing.append(f"lag {motion['lag_s']} +- {motion['lag_error_s']} s")
    return failing


def _is_found(log: Path, name: str, film: Sequence[RawFrame], rng: np.random.Generator) -> bool:
    cut = _cut(film, _FAULTY_S.get(name, 6.0), rng)
    frames, is_found = FAULTS[name]([raw.decode() for raw in cut], rng)
    verdict = examined(_of_memory(frames))
    if not is_found(verdict):
        said = verdict.refusal or "; ".join(verdict.problems + verdict.notes)
        at_s = (cut[0].stamp_ns - film[0].stamp_ns) / 1e9
        print(f"  not found: {name} in {log} from {at_s:.2f} s: {said}; {_evidence(verdict)}", flush=True)
    return is_found(verdict)


def _evidence(verdict: Diagnosis) -> str:
    return "; ".join(f"{name}: {verdict.frames[name]}" for name in ("motion", "depth_bias", "color_on_depth"))


def _cut(film: Sequence[RawFrame], seconds: float, rng: np.random.Generator) -> Sequence[RawFrame]:
    length_s = (film[-1].stamp_ns - film[0].stamp_ns) / 1e9
    start_ns = film[0].stamp_ns + round(1e9 * rng.uniform(0, max(length_s - seconds, 0.0)))
    return [raw for raw in film if start_ns <= raw.stamp_ns <= start_ns + 1e9 * min(seconds, length_s)]


def _posed(frames: Frames, poses: Sequence[NDArray[np.float64]]) -> Frames:
    return [replace(frame, world_from_camera=pose) for frame, pose in zip(frames, poses, strict=True)]


def _scale(frames: Frames, rng: np.random.Generator) -> tuple[Frames, Callable[[Diagnosis], bool]]:
    factor = float(rng.choice([10.0, 4.0, 0.001, 0.2, 1 / 0.3048]))

    def is_found(verdict: Diagnosis) -> bool:
        return bool(np.isclose(verdict.fixes.get("depth_units_per_m", 0), 1000 * factor, rtol=0.06))

    return [replace(f, depth_m=f.depth_m * np.float32(factor)) for f in frames], is_found


def _axes(frames: Frames, rng: np.random.Generator) -> tuple[Frames, Callable[[Diagnosis], bool]]:
    turns = {"-y -z x": FLU_FROM_OPTICAL, "-y x z": Rotation.from_euler("z", -90, degrees=True).as_matrix()}
    turns["x -y -z"] = np.diag([1.0, -1.0, -1.0])
    text = str(rng.choice(sorted(turns)))
    back = from_rotation_translation(turns[text].T, np.zeros(3))
    poses = [compose(frame.world_from_camera, back) for frame in frames]
    return _posed(frames, poses), lambda verdict: verdict.fixes.get("camera_axes") == text


def _mirrored(frames: Frames, rng: np.random.Generator) -> tuple[Frames, Callable[[Diagnosis], bool]]:
    del rng
    flipped = [
        replace(
            f, rgb=np.ascontiguousarray(f.rgb[:, ::-1]), depth_m=np.ascontiguousarray(f.depth_m[:, ::-1]),
            camera=replace(f.camera, cx=f.camera.width - 1 - f.camera.cx),
        )
        for f in frames
    ]  # fmt: skip
    return flipped, lambda verdict: "mirrored" in (verdict.refusal or "")


def _late(frames: Frames, rng: np.random.Generator) -> tuple[Frames, Callable[[Diagnosis], bool]]:
    late_s = float(rng.choice([-0.5, -0.2, 0.15, 0.3, 0.6]))
    times = np.array([(frame.stamp_ns - frames[0].stamp_ns) / 1e9 for frame in frames])
    turns = Slerp(times, Rotation.from_matrix([frame.world_from_camera[:3, :3] for frame in frames]))
    places = np.array([frame.world_from_camera[:3, 3] for frame in frames])
    kept = [i for i, t in enumerate(times) if 0 <= t - late_s <= times[-1]]
    poses = [
        from_rotation_translation(turns(t).as_matrix(), [np.interp(t, times, places[:, k]) for k in range(3)])  # type: ignore[arg-type]
        for t in times[kept] - late_s
    ]

    def is_found(verdict: Diagnosis) -> bool:
        motion, offset_ms = verdict.frames["motion"], verdict.fixes.get("time", {}).get("pose_offset_ms")
        return offset_ms is not None and abs(offset_ms / 1e3 + late_s) <= motion["lag_error_s"]

    return _posed([frames[i] for i in kept], poses), is_found


def _foreign(frames: Frames, rng: np.random.Generator) -> tuple[Frames, Callable[[Diagnosis], bool]]:
    # Another robot drives its own curves.
    times = np.array([(frame.stamp_ns - frames[0].stamp_ns) / 1e9 for frame in frames])
    rates = rng.uniform(-0.6, 0.6, 3)
    yaw = np.cumsum(rates[0] + np.sin(times * (1 + rates[1])) * 0.5) * np.gradient(times)
    steps = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=1) * 0.5 * np.gradient(times)[:, None]
    turns = Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0]).as_matrix() @ FLU_FROM_OPTICAL
    poses = [
        from_rotation_translation(turn, place) for turn, place in zip(turns, np.cumsum(steps, axis=0), strict=True)
    ]
    return _posed(frames, poses), lambda verdict: any("another robot" in text for text in verdict.problems)


def _inverted(frames: Frames, rng: np.random.Generator) -> tuple[Frames, Callable[[Diagnosis], bool]]:
    del rng
    poses = [invert(frame.world_from_camera) for frame in frames]
    return _posed(frames, poses), lambda verdict: "inverted" in (verdict.refusal or "")


def _twice(frames: Frames, rng: np.random.Generator) -> tuple[Frames, Callable[[Diagnosis], bool]]:
    del rng
    start = frames[0].world_from_camera
    poses = [compose(invert(start), frame.world_from_camera) for frame in frames]
    return _posed(frames, [compose(p, p) for p in poses]), lambda verdict: "applied twice" in (verdict.refusal or "")


def _bias(frames: Frames, rng: np.random.Generator) -> tuple[Frames, Callable[[Diagnosis], bool]]:
    bias_m = float(rng.choice([-0.12, -0.08, 0.08, 0.12]))

    def is_found(verdict: Diagnosis) -> bool:
        found = verdict.frames["depth_bias"]
        return found is not None and found["is_off"] and abs(found["bias_m"] - bias_m) <= 3 * found["error_m"]

    return [replace(f, depth_m=f.depth_m + np.float32(bias_m)) for f in frames], is_found


def _link(frames: Frames, rng: np.random.Generator) -> tuple[Frames, Callable[[Diagnosis], bool]]:
    # The link from depth to colour is off by an inch and more.
    x_m = float(rng.choice([-0.04, -0.03, 0.03, 0.04]))
    camera, link = frames[0].camera, from_rotation_translation(np.eye(3), np.array([x_m, 0.0, 0.0]))
    registration = Registration(depth_camera=camera, color_camera=camera, color_from_depth=link)

    def is_found(verdict: Diagnosis) -> bool:
        found = verdict.frames["color_on_depth"]
        return bool(found and found["is_off"] and abs(found["offset_m"][0] + x_m) <= found["error_m"])

    return [replace(f, depth_m=register_depth(f.depth_m, registration)) for f in frames], is_found


def _noise(frames: Frames, rng: np.random.Generator) -> tuple[Frames, Callable[[Diagnosis], bool]]:
    def noisy(depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        return (depth_m + rng.normal(0, 0.01, depth_m.shape) * depth_m * depth_m).astype(np.float32)

    found = [replace(frame, depth_m=noisy(frame.depth_m)) for frame in frames]
    return found, lambda verdict: any("times the noise" in note for note in verdict.notes)


FAULTS: dict[str, Fault] = {
    "scale": _scale, "axes": _axes, "mirrored": _mirrored, "lag": _late, "robot": _foreign, "inverted": _inverted,
    "twice": _twice, "bias": _bias, "noise": _noise, "link": _link,
}  # fmt: skip
