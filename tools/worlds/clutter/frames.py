"""Single frames of random rooms with ground truth, without a log: training data for networks."""
# Random cameras: field of view, and defects of colour and depth.

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import ConfigError
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.worlds.clearance import is_inside
from hickory_stream.worlds.depth_camera import DepthCameraConfig, sensed_depth
from hickory_stream.worlds.rendering import Probe, Renderer
from hickory_stream.worlds.trajectory import camera_rotation
from tools.worlds.clutter.draws import chance, log_uniform, one_of, uniform
from tools.worlds.clutter.kit import FAMILIES, recipes_of
from tools.worlds.clutter.room import ClutterRoom, clutter_room


@dataclass(frozen=True, kw_only=True, slots=True)
class ColorCameraConfig:
    """The defects of a colour image; the defaults are none."""

    exposure: float = 1.0
    gamma: float = 1.0
    warmth: float = 0.0
    """The gain of red over that of blue, as a share."""
    vignette: float = 0.0
    """Vignetting: the share of the light that is missing in the corners."""
    blur_px: float = 0.0
    motion_px: tuple[float, float] = (0.0, 0.0)
    noise: float = 0.0
    """Standard deviation of the noise in grey levels, at mid-grey."""
    #: (x, y) of colour against depth.
    shift_px: tuple[float, float] = (0.0, 0.0)
    #: The additional shift of the last row: a rolling shutter in motion.
    skew_px: float = 0.0
    #: The amplitude of a smooth variation of the shift.
    wobble_px: float = 0.0

    def photographed(self, rgb: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return the (H, W, 3) image as the camera reports it."""
        height, width = rgb.shape[:2]
        image = _displaced(rgb.astype(np.float32) / np.float32(255), self, rng)
        if self.blur_px > 0.1:
            image = cv2.GaussianBlur(image, (0, 0), self.blur_px)
        if max(abs(v) for v in self.motion_px) >= 1.0:
            image = _smeared(image, self.motion_px)
        v, u = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
        gain = self.exposure * (1.0 - self.vignette * (u * u + v * v) / 2)
        tint = np.array([1 + self.warmth / 2, 1.0, 1 - self.warmth / 2], dtype=np.float32)
        image = np.clip(image * gain[..., None] * tint, 0.0, 1.0) ** np.float32(self.gamma)
        if self.noise:
            # Photon noise grows with the light; read noise does not.
            level = self.noise / 255 * np.sqrt(0.35 + 1.3 * image)
            image = image + level * rng.standard_normal(image.shape, dtype=np.float32)
        return np.asarray((np.clip(image, 0.0, 1.0) * 255 + 0.5).astype(np.uint8))


def _displaced(image: NDArray[np.float32], config: ColorCameraConfig, rng: np.random.Generator) -> NDArray[np.float32]:
    if config.shift_px == (0.0, 0.0) and config.skew_px == 0.0 and config.wobble_px == 0.0:
        return image
    height, width = image.shape[:2]
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    u = u + np.float32(config.shift_px[0]) + np.float32(config.skew_px / height) * v
    v = v + np.float32(config.shift_px[1])
    if config.wobble_px:
        coarse = config.wobble_px * rng.standard_normal((2, 4, 5))
        u, v = (
            at + cv2.resize(field, (width, height), interpolation=cv2.INTER_CUBIC).astype(np.float32)
            for at, field in zip((u, v), coarse, strict=True)
        )
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def _smeared(image: NDArray[np.float32], motion_px: tuple[float, float]) -> NDArray[np.float32]:
    size = 2 * int(np.ceil(max(abs(v) for v in motion_px) / 2)) + 1
    kernel = np.zeros((size, size), dtype=np.float32)
    for share in np.linspace(-0.5, 0.5, 4 * size):
        x, y = (round(size // 2 + share * v) for v in motion_px)
        kernel[y, x] += 1
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE))


def random_camera(rng: np.random.Generator, width: int, height: int) -> Camera:
    """Return a pinhole camera of 50 to 100 degrees across, its optical axis near the middle."""
    focal = width / 2 / np.tan(np.radians(uniform(rng, 50.0, 100.0)) / 2)
    return Camera(
        width=width, height=height, fx=float(focal), fy=float(focal * uniform(rng, 0.99, 1.01)),
        cx=(width - 1) / 2 + float(rng.normal(0, 0.01 * width)),
        cy=(height - 1) / 2 + float(rng.normal(0, 0.01 * height)),
    )  # fmt: skip


def random_depth_camera(rng: np.random.Generator, focal_px: float) -> DepthCameraConfig:
    """Return a stereo or structured-light camera, from good to poor."""
    # Noise is 0.1 % to 0.8 % at one metre, at any focal length: small images are not noisier than large ones.
    baseline = log_uniform(rng, 0.05, 0.2)
    sigma = log_uniform(rng, 0.0008, 0.006) * baseline * focal_px
    return DepthCameraConfig(
        baseline_m=baseline, min_depth_m=uniform(rng, 0.15, 0.45), max_depth_m=log_uniform(rng, 4.0, 12.0),
        disparity_sigma_px=sigma, correlation_px=uniform(rng, 1.0, 4.0), white_share=uniform(rng, 0.05, 0.8),
        disparity_step_px=sigma * log_uniform(rng, 0.3, 2.5), grazing_cosine=uniform(rng, 0.08, 0.3),
        edge_ratio=uniform(rng, 0.03, 0.08), edge_loss=uniform(rng, 0.0, 0.7), flying_share=uniform(rng, 0.0, 0.5),
        dropout_share=uniform(rng, 0.0, 0.1) if chance(rng, 0.8) else 0.0,
    )  # fmt: skip


def random_color_camera(rng: np.random.Generator, width: int) -> ColorCameraConfig:
    """Return the defects of a colour image: exposure, tint, blur, noise, and displacement from depth."""
    scale = width / 320
    off = scale * log_uniform(rng, 0.2, 2.5) if chance(rng, 0.6) else 0.0
    moving = 0.3 * scale * log_uniform(rng, 1.0, 25.0) if chance(rng, 0.25) else 0.0
    turn = uniform(rng, 0, 2 * np.pi)
    return ColorCameraConfig(
        exposure=log_uniform(rng, 0.55, 1.5), gamma=log_uniform(rng, 0.7, 1.35), warmth=float(rng.normal(0, 0.12)),
        vignette=uniform(rng, 0.0, 0.5) if chance(rng, 0.5) else 0.0, blur_px=uniform(rng, 0.0, 1.1) * scale,
        motion_px=(float(moving * np.cos(turn)), float(moving * np.sin(turn))), noise=log_uniform(rng, 0.5, 10.0),
        shift_px=(float(off * rng.normal(0, 0.7)), float(off * rng.normal(0, 0.4))),
        skew_px=float(off * rng.normal(0, 0.7)), wobble_px=0.25 * off,
    )  # fmt: skip


_DRAWS = 40
_PROBE_PX = 48
_LOW_M, _HIGH_M = 0.3, 1.8


def random_view(
    rng: np.random.Generator, room: ClutterRoom, renderer: Renderer, camera: Camera
) -> NDArray[np.float64] | None:
    """Return `world_from_camera` of a view from free space with things in it; None if no draw finds one."""
    if not room.world.objects:
        return None
    least = 1 if chance(rng, 0.1) else 3
    covered = uniform(rng, 0.03, 0.4)
    small = camera.scaled(_PROBE_PX / camera.width)
    for _ in range(_DRAWS):
        pose = _at_something(rng, room) if chance(rng, 0.75) else _anywhere(rng, room)
        if is_inside(pose[None, :2, 3], room.plan.outline_m)[0] and _shows(renderer.probe(small, pose), least, covered):
            return pose
    return None


def _shows(probe: Probe, least: int, covered: float) -> bool:
    near = float((probe.depth_m < 0.25).mean())
    counts = np.unique(probe.instances[probe.instances > 0], return_counts=True)[1]
    shares = counts / len(probe.instances)
    return (
        near < 0.03
        and float(probe.is_within.mean()) < 0.004
        and 0.45 < float(np.median(probe.depth_m)) < 7.0
        and int((shares > 0.003).sum()) >= least
        and float(shares.max(initial=0.0)) < 0.65
        and float(shares.sum()) >= covered
    )


def _at_something(rng: np.random.Generator, room: ClutterRoom) -> NDArray[np.float64]:
    item = one_of(rng, room.world.objects)
    low, high = item.model.bounds_m()
    center = (item.world_from_object @ [*((low + high) / 2), 1.0])[:3]
    size = float(np.linalg.norm(high - low))
    turn, away = uniform(rng, 0, 2 * np.pi), log_uniform(rng, 0.4, 2.6) + 0.45 * size
    eye = np.array([center[0] + away * np.cos(turn), center[1] + away * np.sin(turn), uniform(rng, _LOW_M, _HIGH_M)])
    to = center - eye
    yaw = float(np.arctan2(to[1], to[0])) + float(rng.normal(0, 0.2))
    pitch = float(np.arctan2(to[2], np.hypot(to[0], to[1]))) + float(rng.normal(0, 0.12))
    return _pose(rng, eye, yaw, float(np.clip(pitch, -1.2, 0.5)))


def _anywhere(rng: np.random.Generator, room: ClutterRoom) -> NDArray[np.float64]:
    x0, y0, x1, y1 = room.plan.bounds_m
    eye = np.array([uniform(rng, x0, x1), uniform(rng, y0, y1), uniform(rng, _LOW_M, _HIGH_M)])
    # A low camera looks ahead, a high one down.
    pitch = float(rng.normal(-0.25 * (eye[2] - 0.5), 0.15))
    return _pose(rng, eye, uniform(rng, -np.pi, np.pi), pitch)


def _pose(rng: np.random.Generator, eye: NDArray[np.float64], yaw: float, pitch: float) -> NDArray[np.float64]:
    roll = float(rng.normal(0, 0.2)) if chance(rng, 0.15) else float(rng.normal(0, 0.03))
    return from_rotation_translation(camera_rotation(yaw, pitch, roll), eye)


_FRAMES_A_ROOM = 12
_MIDDLE_GREY = 110.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Frame:
    """A frame of a camera with defects, and its exact truth; a pixel without id and structure hits nothing."""

    rgb: NDArray[np.uint8]
    #: (H, W), NaN where the camera reports nothing.
    depth_m: NDArray[np.float32]
    #: (H, W), NaN where a ray hits nothing.
    exact_depth_m: NDArray[np.float32]
    #: (H, W) ids of `room`, 0: no object.
    instances: NDArray[np.uint16]
    is_structure: NDArray[np.bool_]
    camera: Camera
    #: (4, 4), z up.
    world_from_camera: NDArray[np.float64]
    #: The number of the room of seed and family.
    room: int

    def __post_init__(self) -> None:
        size = self.depth_m.shape
        freeze(self, "rgb", np.uint8, (*size, 3))
        freeze(self, "depth_m", np.float32, size)
        freeze(self, "exact_depth_m", np.float32, size)
        freeze(self, "instances", np.uint16, size)
        freeze(self, "is_structure", np.bool_, size)
        freeze(self, "world_from_camera", np.float64, (4, 4))


def frames_of(seed: int, family: str, count: int, width: int = 320, height: int = 240) -> Iterator[Frame]:
    """Yield frames of random rooms of a family, several from each room; a longer sequence begins with the shorter one.

    Raises:
        ConfigError: there is no such family, or the image size is out of range.
    """
    recipes_of(family)
    if not (32 <= width <= 4096 and 32 <= height <= 4096):
        raise ConfigError(f"frames of {width}x{height}; expected 32 to 4096 pixels a side")
    if seed < 0:
        raise ConfigError(f"seed {seed}; expected 0 or more")
    made, index = 0, 0
    while made < count:
        for frame in _frames_of_room(seed, family, index, (width, height)):
            yield frame
            made += 1
            if made == count:
                return
        index += 1


def _frames_of_room(seed: int, family: str, index: int, size: tuple[int, int]) -> Iterator[Frame]:
    room = clutter_room(seed, family, index)
    if not room.world.objects:
        return
    renderer = Renderer(room.world)
    for i in range(_FRAMES_A_ROOM):
        rng = np.random.default_rng([seed, 22, FAMILIES.index(family), index, i])
        frame = _frame(rng, room, renderer, index, size)
        if frame is not None:
            yield frame


def _frame(
    rng: np.random.Generator, room: ClutterRoom, renderer: Renderer, index: int, size: tuple[int, int]
) -> Frame | None:
    camera = random_camera(rng, *size)
    world_from_camera = random_view(rng, room, renderer, camera)
    if world_from_camera is None:
        return None
    rendered = renderer.render(camera, world_from_camera)
    depth = random_depth_camera(rng, camera.fx)
    color = random_color_camera(rng, camera.width)
    # Automatic exposure, with an error.
    gain = float(np.clip(_MIDDLE_GREY / max(float(rendered.rgb.mean()), 1.0), 0.6, 4.0))
    color = replace(color, exposure=color.exposure * gain)
    return Frame(
        rgb=color.photographed(rendered.rgb, rng),
        depth_m=sensed_depth(rendered.depth_m, rendered.cosine, camera.fx, depth, rng, rendered.is_blind),
        exact_depth_m=rendered.depth_m, instances=rendered.instances, is_structure=rendered.is_structure, camera=camera,
        world_from_camera=world_from_camera, room=index,
    )  # fmt: skip
