"""The verdicts of `doctor`: silence on cuts of sound logs, and faults that were put into them."""
# A cut is a piece of a log; a fault changes its depth, colour or poses. A verdict is right if it names the fault with a
# value whose interval holds the truth.

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert
from hickory_stream.poses.hand_eye import FLU_FROM_OPTICAL
from hickory_stream.records import Frame, RawFrame, SourceInfo
from hickory_stream.worlds.recording import make_recording
from players import open_source
from players.doctor.diagnosis import Diagnosis, examine_frames
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.worlds.recording_config import RecordingConfig

Frames = Sequence[Frame]
Fault = Callable[[Frames, np.random.Generator], tuple[Frames, Callable[[Diagnosis], bool]]]

_DEMO = Path("recordings/demo.mcap")
_ROOMS = (("room", 11), ("apartment", 5), ("outdoor", 3))
_SECONDS, _LENGTHS_S, _FAULTY_S = 10.0, (2.0, 3.0, 5.0, 8.0), 6.0
_CASES, _QUICK_CASES = 100, 20


@dataclass(frozen=True)
class Cut:
    """A source of decoded frames."""

    content: Frames

    @property
    def info(self) -> SourceInfo:
        first, last = self.content[0], self.content[-1]
        return SourceInfo(
            uri="memory:cut", kind="cut", identity="cut", camera=first.camera, num_frames=len(self.content),
            start_ns=first.stamp_ns, end_ns=last.stamp_ns, streams=(),
        )  # fmt: skip

    def frames(self) -> Iterator[RawFrame]:
        for i, frame in enumerate(self.content):
            pose = {"world_from_camera": frame.world_from_camera, "camera": frame.camera}
            yield RawFrame(index=i, stamp_ns=frame.stamp_ns, decode=lambda frame=frame: frame, **pose)  # type: ignore[misc]

    def ledger(self) -> dict[str, int]:
        return {"frames": len(self.content)}

    def close(self) -> None:
        pass


def examined(frames: Frames) -> Diagnosis:
    """Return the diagnosis of a cut."""
    found = Diagnosis(uri="cut")
    examine_frames(found, Cut(frames), {})
    return found


def measure(options: Options) -> list[Figure]:
    """Return the figures; `--scenes` names the truth folders of further sound logs, `log.mcap` beside each."""
    number = _QUICK_CASES if options.quick else _CASES
    rng = np.random.default_rng(options.seed)
    with tempfile.TemporaryDirectory() as temporary:
        logs = [_DEMO, *(path.parent / "log.mcap" if path.is_dir() else path for path in options.scenes)]
        for scene, seed in _ROOMS:
            config = RecordingConfig(scene=scene, seed=seed, seconds=_SECONDS, rate_hz=6.0, width=480, height=270)
            make_recording(config, Path(temporary), scene, caster=None)
            logs.append(Path(temporary) / f"{scene}.mcap")
        films = [[raw.decode() for raw in open_source(log).frames()] for log in logs]
    alarms = sum(
        _is_alarm(films[i % len(films)], _LENGTHS_S[i // len(films) % len(_LENGTHS_S)], rng) for i in range(number)
    )
    names = sorted(FAULTS)
    found = sum(_is_found(names[i % len(names)], films[i // len(names) % len(films)], rng) for i in range(number))
    return [
        figure("doctor_false_alarms", alarms, "", "lower", of=f"{number} sound cuts of 2 to 8 s"),
        figure("doctor_found_fraction", found / number, of=f"{number} cuts of {_FAULTY_S:.0f} s with a fault"),
    ]


def _is_alarm(film: Frames, length_s: float, rng: np.random.Generator) -> bool:
    found = examined(_cut(film, length_s, rng))
    # A cut of 2 s has too few keyframes, which is true.
    said = [text for text in (found.refusal or "", *found.problems) if text and "keyframes" not in text]
    for text in said:
        print(f"  false alarm in {length_s:.0f} s at {film[0].stamp_ns}: {text}", flush=True)
    return bool(said)


def _is_found(name: str, film: Frames, rng: np.random.Generator) -> bool:
    frames, is_found = FAULTS[name](_cut(film, _FAULTY_S, rng), rng)
    verdict = examined(frames)
    if not is_found(verdict):
        said = verdict.refusal or "; ".join(verdict.problems + verdict.notes)
        print(f"  not found: {name} in {film[0].camera.width}: {said}; {verdict.frames['motion']}", flush=True)
    return is_found(verdict)


def _cut(film: Frames, seconds: float, rng: np.random.Generator) -> Frames:
    length_ns = (film[-1].stamp_ns - film[0].stamp_ns) / 1e9
    start_ns = film[0].stamp_ns + round(1e9 * rng.uniform(0, max(length_ns - seconds, 0.0)))
    return [frame for frame in film if start_ns <= frame.stamp_ns <= start_ns + 1e9 * seconds]


def _posed(frames: Frames, poses: Sequence[NDArray[np.float64]]) -> Frames:
    return [replace(frame, world_from_camera=pose) for frame, pose in zip(frames, poses, strict=True)]


def _scale(frames: Frames, rng: np.random.Generator) -> tuple[Frames, Callable[[Diagnosis], bool]]:
    factor = float(rng.choice([10.0, 4.0, 0.001, 0.2, 1 / 0.3048]))

    def is_found(verdict: Diagnosis) -> bool:
        return np.isclose(verdict.fixes.get("depth_units_per_m", 0), 1000 * factor, rtol=0.06)

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


def _noise(frames: Frames, rng: np.random.Generator) -> tuple[Frames, Callable[[Diagnosis], bool]]:
    def noisy(depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        return (depth_m + rng.normal(0, 0.01, depth_m.shape) * depth_m * depth_m).astype(np.float32)

    found = [replace(frame, depth_m=noisy(frame.depth_m)) for frame in frames]
    return found, lambda verdict: any("times the noise" in note for note in verdict.notes)


FAULTS: dict[str, Fault] = {
    "scale": _scale, "axes": _axes, "mirrored": _mirrored, "lag": _late, "robot": _foreign, "inverted": _inverted,
    "twice": _twice, "bias": _bias, "noise": _noise,
}  # fmt: skip
