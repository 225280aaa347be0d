"""Random cameras: field of view, and defects of colour and depth."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.camera import Camera
from hickory_stream.worlds.depth_camera import DepthCameraConfig
from tools.worlds.clutter.draws import chance, log_uniform, uniform


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
        width=width,
        height=height,
        fx=float(focal),
        fy=float(focal * uniform(rng, 0.99, 1.01)),
        cx=(width - 1) / 2 + float(rng.normal(0, 0.01 * width)),
        cy=(height - 1) / 2 + float(rng.normal(0, 0.01 * height)),
    )


def random_depth_camera(rng: np.random.Generator, focal_px: float) -> DepthCameraConfig:
    """Return a stereo or structured-light camera, from good to poor."""
    # Noise is 0.1 % to 0.8 % at one metre, at any focal length: small images are not noisier than large ones.
    baseline = log_uniform(rng, 0.05, 0.2)
    sigma = log_uniform(rng, 0.0008, 0.006) * baseline * focal_px
    return DepthCameraConfig(
        baseline_m=baseline,
        min_depth_m=uniform(rng, 0.15, 0.45),
        max_depth_m=log_uniform(rng, 4.0, 12.0),
        disparity_sigma_px=sigma,
        correlation_px=uniform(rng, 1.0, 4.0),
        white_share=uniform(rng, 0.05, 0.8),
        disparity_step_px=sigma * log_uniform(rng, 0.3, 2.5),
        grazing_cosine=uniform(rng, 0.08, 0.3),
        edge_ratio=uniform(rng, 0.03, 0.08),
        edge_loss=uniform(rng, 0.0, 0.7),
        flying_share=uniform(rng, 0.0, 0.5),
        dropout_share=uniform(rng, 0.0, 0.1) if chance(rng, 0.8) else 0.0,
    )


def random_color_camera(rng: np.random.Generator, width: int) -> ColorCameraConfig:
    """Return the defects of a colour image: exposure, tint, blur, noise, and displacement from depth."""
    scale = width / 320
    off = scale * log_uniform(rng, 0.2, 2.5) if chance(rng, 0.6) else 0.0
    moving = 0.3 * scale * log_uniform(rng, 1.0, 25.0) if chance(rng, 0.25) else 0.0
    turn = uniform(rng, 0, 2 * np.pi)
    return ColorCameraConfig(
        exposure=log_uniform(rng, 0.55, 1.5),
        gamma=log_uniform(rng, 0.7, 1.35),
        warmth=float(rng.normal(0, 0.12)),
        vignette=uniform(rng, 0.0, 0.5) if chance(rng, 0.5) else 0.0,
        blur_px=uniform(rng, 0.0, 1.1) * scale,
        motion_px=(float(moving * np.cos(turn)), float(moving * np.sin(turn))),
        noise=log_uniform(rng, 0.5, 10.0),
        shift_px=(float(off * rng.normal(0, 0.7)), float(off * rng.normal(0, 0.4))),
        skew_px=float(off * rng.normal(0, 0.7)),
        wobble_px=0.25 * off,
    )
