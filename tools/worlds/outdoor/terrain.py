"""Uneven ground: pavement, road a kerb lower, and a lawn that rises and rolls, along x and downhill."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.geometry.arrays import freeze
from hickory_stream.worlds.object_models import Model
from hickory_stream.worlds.textures import Texture
from tools.worlds.clutter.objects.solids import sheet

if TYPE_CHECKING:
    from numpy.typing import NDArray

_CELL_M = 0.2
_THICK_M = 0.4
_JOINT_M = 1e-4
_KERB_STONE_M = 0.14
_CROSSING_M = 1.1
_WAVES = 5


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Terrain:
    """Heights over a street from -x to x, between `front_m` of the houses and `back_m` of the lawn."""

    length_m: float
    front_m: float
    back_m: float
    #: The y of the far and the near kerb; the pavement is beyond the near one.
    kerbs_m: tuple[float, float]
    kerb_height_m: float
    #: Of the street along x, and of pavement and lawn across.
    slope: tuple[float, float, float]
    wave_m: float
    #: (W, 4) rows of the lawn's waves: wave numbers along x and y, phase, share of `wave_m`.
    waves: NDArray[np.float64]
    #: The x at which kerbs are lowered.
    crossings_m: tuple[float, ...]

    def __post_init__(self) -> None:
        freeze(self, "waves", np.float64, (None, 4))

    def height_m(self, places: NDArray[Any]) -> NDArray[np.float64]:
        """Return the (...) heights of the ground at (..., 2) places."""
        x, y = np.asarray(places, dtype=np.float64)[..., 0], np.asarray(places, dtype=np.float64)[..., 1]
        far, near = self.kerbs_m
        along, pavement, lawn = self.slope
        rolling = sum(share * np.sin(kx * x + ky * y + phase) for kx, ky, phase, share in self.waves)
        # A road is arched, a pavement falls to its kerb; both roll a little with the ground under them.
        middle, half = (far + near) / 2, (near - far) / 2
        crown = 0.06 * (1 - np.clip((y - middle) / half, -1, 1) ** 2)
        lowered = sum(np.exp(-(((x - at) / _CROSSING_M) ** 4)) for at in self.crossings_m)
        kerb = self.kerb_height_m * (1 - 0.85 * np.clip(lowered, 0, 1))
        # Behind a lowered kerb the ground rises to its usual height within a metre.
        beyond = np.maximum(y - near, far - y)
        kerb = np.where(beyond > 0, kerb + (self.kerb_height_m - kerb) * np.clip(beyond / 1.2, 0, 1), 0.0)
        across = np.where(y > near, pavement * (y - near), np.where(y < far, lawn * (far - y), crown))
        on_lawn = np.clip((far - y) / 2.0, 0, 1)
        return np.asarray(along * x + kerb + across + self.wave_m * rolling * (0.12 + 0.88 * on_lawn))

    def models(self, rng: np.random.Generator) -> tuple[Model, ...]:
        """Return pavement, kerb stones, road and lawn."""
        far, near = self.kerbs_m
        strips = (
            ("lawn", self.back_m, far - _KERB_STONE_M, _grass(rng)),
            ("kerb", far - _KERB_STONE_M, far, _stone(rng)),
            ("road", far, near, _asphalt(rng)),
            ("kerb", near, near + _KERB_STONE_M, _stone(rng)),
            ("pavement", near + _KERB_STONE_M, self.front_m, _paving(rng)),
        )
        return tuple(Model(kind=kind, parts=(self._strip(low, high, texture),)) for kind, low, high, texture in strips)

    def _strip(self, low: float, high: float, texture: Texture) -> Any:
        xs = np.linspace(-self.length_m / 2, self.length_m / 2, 1 + round(self.length_m / _CELL_M))
        ys = np.linspace(low, high, 2 + round((high - low) / _CELL_M))
        grid = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1)
        # At a kerb, the height of a strip is that on its own side.
        inside = grid.copy()
        inside[..., 1] = np.clip(inside[..., 1], low + _JOINT_M, high - _JOINT_M)
        return sheet(np.concatenate([grid, self.height_m(inside)[..., None]], axis=2), _THICK_M, texture)


def random_terrain(rng: np.random.Generator, length_m: float, crossings_m: tuple[float, ...]) -> Terrain:
    """Return a terrain of a seed: waves of 0.1 to 0.5 m on the lawn, a street that falls by 1 to 4 %."""
    turns = rng.uniform(0, 2 * np.pi, _WAVES)
    lengths = rng.uniform(7.0, 22.0, _WAVES)
    shares = rng.uniform(0.3, 1.0, _WAVES)
    waves = np.column_stack(
        [
            2 * np.pi / lengths * np.cos(turns),
            2 * np.pi / lengths * np.sin(turns),
            rng.uniform(0, 2 * np.pi, _WAVES),
            shares / shares.sum(),
        ]
    )
    return Terrain(
        length_m=length_m,
        front_m=6.4,
        back_m=-14.0,
        kerbs_m=(-4.2, 1.6),
        kerb_height_m=float(rng.uniform(0.11, 0.15)),
        slope=(
            float(rng.uniform(0.01, 0.04)) * (1.0 if rng.random() < 0.5 else -1.0),
            float(rng.uniform(0.015, 0.025)),
            float(rng.uniform(0.02, 0.07)),
        ),
        wave_m=float(rng.uniform(0.1, 0.5)),
        waves=waves,
        crossings_m=crossings_m,
    )


def _paving(rng: np.random.Generator) -> Texture:
    grey = float(rng.uniform(0.5, 0.62))
    return Texture(
        pattern="tiles",
        first=(grey, grey * 0.98, grey * 0.94),
        second=(grey * 0.8, grey * 0.79, grey * 0.77),
        period_m=float(rng.uniform(0.4, 0.6)),
        grain=0.2,
    )


def _asphalt(rng: np.random.Generator) -> Texture:
    grey = float(rng.uniform(0.24, 0.34))
    lighter = grey * 1.25
    return Texture(
        pattern="speckle",
        first=(grey, grey, grey * 1.03),
        second=(lighter, lighter, lighter),
        period_m=0.015,
        grain=0.3,
    )


def _stone(rng: np.random.Generator) -> Texture:
    grey = float(rng.uniform(0.62, 0.72))
    return Texture(
        pattern="speckle",
        first=(grey, grey, grey * 0.98),
        second=(grey * 0.85, grey * 0.85, grey * 0.84),
        period_m=0.01,
        grain=0.2,
    )


def _grass(rng: np.random.Generator) -> Texture:
    green = float(rng.uniform(0.36, 0.46))
    return Texture(
        pattern="plain",
        first=(green * 0.66, green, green * 0.36),
        second=(green * 0.95, green * 1.08, green * 0.52),
        period_m=0.7,
        grain=0.55,
    )
