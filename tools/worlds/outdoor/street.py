"""A street from a seed: parked cars, trees and objects on pavement, road and a rolling lawn."""
# Objects with separate feet or wheels tilt with the ground. Crowns of trees and fronts of houses are not objects.

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import ConfigError
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.worlds.lighting import Lamp, Lighting
from hickory_stream.worlds.object_models import Model, ellipsoid, tube
from hickory_stream.worlds.palettes import plain
from hickory_stream.worlds.scene import Placement, World, at_place, numbered
from hickory_stream.worlds.textures import Texture
from tools.worlds.clutter.draws import chance, count, uniform
from tools.worlds.clutter.objects.solids import block, rough, sheet
from tools.worlds.outdoor import street_things as things

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
    waves = np.column_stack([
        2 * np.pi / lengths * np.cos(turns), 2 * np.pi / lengths * np.sin(turns), rng.uniform(0, 2 * np.pi, _WAVES),
        shares / shares.sum(),
    ])  # fmt: skip
    return Terrain(
        length_m=length_m, front_m=6.4, back_m=-14.0, kerbs_m=(-4.2, 1.6), kerb_height_m=float(rng.uniform(0.11, 0.15)),
        slope=(
            float(rng.uniform(0.01, 0.04)) * (1.0 if rng.random() < 0.5 else -1.0),
            float(rng.uniform(0.015, 0.025)),
            float(rng.uniform(0.02, 0.07)),
        ),
        wave_m=float(rng.uniform(0.1, 0.5)), waves=waves, crossings_m=crossings_m,
    )  # fmt: skip


def _paving(rng: np.random.Generator) -> Texture:
    grey = float(rng.uniform(0.5, 0.62))
    return Texture(
        pattern="tiles", first=(grey, grey * 0.98, grey * 0.94), second=(grey * 0.8, grey * 0.79, grey * 0.77),
        period_m=float(rng.uniform(0.4, 0.6)), grain=0.2,
    )  # fmt: skip


def _asphalt(rng: np.random.Generator) -> Texture:
    grey = float(rng.uniform(0.24, 0.34))
    lighter = grey * 1.25
    return Texture(
        pattern="speckle", first=(grey, grey, grey * 1.03), second=(lighter, lighter, lighter), period_m=0.015,
        grain=0.3,
    )  # fmt: skip


def _stone(rng: np.random.Generator) -> Texture:
    grey = float(rng.uniform(0.62, 0.72))
    return Texture(
        pattern="speckle", first=(grey, grey, grey * 0.98), second=(grey * 0.85, grey * 0.85, grey * 0.84),
        period_m=0.01, grain=0.2,
    )  # fmt: skip


def _grass(rng: np.random.Generator) -> Texture:
    green = float(rng.uniform(0.36, 0.46))
    return Texture(
        pattern="plain", first=(green * 0.66, green, green * 0.36), second=(green * 0.95, green * 1.08, green * 0.52),
        period_m=0.7, grain=0.55,
    )  # fmt: skip


_HALF_M = 7.0
_CROSSINGS_M = (-5.4, 5.4)
_DRAWS = 30
_MIN_THINGS, _MIN_KINDS = 22, 9
_ATTEMPTS = 40
# Objects with separate feet or wheels, which are tilted with the ground.
_TILTED = frozenset({"car", "park_bench", "crate", "boulder", "wheeled_bin", "planter", "junction_box"})
_CROWN_M = 4.0
_REST_M = 0.0005


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Street:
    """A world and the ground that it stands on."""

    world: World
    terrain: Terrain


def street(seed: int, attempt: int = 0) -> Street:
    """Return street number `attempt` of a seed, with 22 and more objects of at least nine kinds."""
    # Raises ConfigError: no draw fits, which no seed has shown so far.
    rng = np.random.default_rng([seed, 31, attempt])
    for _ in range(_ATTEMPTS):
        found = _draw(rng)
        kinds = {item.model.kind for item in found.world.objects}
        if len(found.world.objects) >= _MIN_THINGS and len(kinds) >= _MIN_KINDS:
            return found
    raise ConfigError(f"seed {seed}: no street of {_MIN_THINGS} things in {_ATTEMPTS} draws; choose another --seed")


def _draw(rng: np.random.Generator) -> Street:
    terrain = random_terrain(rng, 2 * _HALF_M + 16.0, _CROSSINGS_M)
    far, near = terrain.kerbs_m
    placed: list[Placement] = []
    # Cars park along both kerbs, between the crossings.
    for y, yaw in ((near - 1.05, 0.0), (far + 1.05, np.pi)):
        x = uniform(rng, -4.3, -3.6)
        while x < 3.0:
            model = things.car(rng)
            length = float(model.bounds_m()[1, 0] - model.bounds_m()[0, 0])
            if x + length < 4.6 and chance(rng, 0.85):
                _stand(
                    placed, terrain, model, (x + length / 2, y + float(rng.normal(0, 0.05))), yaw + _slightly(rng, 0.03)
                )
            x += length + uniform(rng, 0.6, 1.0)
    # A row of trees on the lawn, a few on the pavement beside the kerb.
    for low, high, number in ((far - 2.0, far - 0.8, 3), (far - 5.6, far - 4.6, 3), (near + 0.5, near + 0.7, 2)):
        _scatter(rng, placed, terrain, things.trunk, number, (low, high), 1.0)
    _scatter(rng, placed, terrain, things.bollard, count(rng, 2, 4), (near + 0.35, near + 0.5), 0.6)
    _scatter(rng, placed, terrain, things.sign_post, count(rng, 1, 2), (near + 0.4, near + 0.6), 0.6)
    for recipe in (things.hydrant, things.litter_bin, things.junction_box):
        _scatter(rng, placed, terrain, recipe, count(rng, 1, 2), (near + 0.55, near + 0.75), 0.5)
    # Along the houses, facing the street.
    for recipe in (things.wheeled_bin, things.planter, things.crate, things.park_bench):
        _scatter(rng, placed, terrain, recipe, count(rng, 1, 2), (terrain.front_m - 0.9, terrain.front_m - 0.6), 0.4)
    for recipe in (things.park_bench, things.litter_bin, things.boulder, things.crate, things.bollard):
        _scatter(rng, placed, terrain, recipe, count(rng, 1, 2), (far - 5.8, far - 0.8), 0.6)
    crowns = [_crown(rng, one) for one in placed if one.model.kind == "trunk"]
    world = World(
        objects=numbered(placed),
        structure=(*terrain.models(rng), *_houses(rng, terrain), *crowns),
        rooms_m=((-_HALF_M, far - 6.6, _HALF_M, terrain.front_m),),
        middle_m=(0.0, (far + near) / 2),
        lighting=_daylight(rng),
    )
    return Street(world=world, terrain=terrain)


def _slightly(rng: np.random.Generator, spread: float) -> float:
    return float(rng.normal(0, spread))


def _scatter(
    rng: np.random.Generator, placed: list[Placement], terrain: Terrain, recipe: Callable[[np.random.Generator], Model],
    number: int, span_m: tuple[float, float], margin_m: float,
) -> None:  # fmt: skip
    middle = (terrain.kerbs_m[0] + terrain.kerbs_m[1]) / 2
    for _ in range(number):
        model = recipe(rng)
        for _ in range(_DRAWS):
            x, y = uniform(rng, -_HALF_M + 0.8, _HALF_M - 0.8), uniform(rng, *span_m)
            # The crossings stay free.
            if min(abs(x - at) for at in _CROSSINGS_M) < 1.3 and y > terrain.kerbs_m[0] - 1.5:
                continue
            facing = -np.pi / 2 if y > middle else np.pi / 2
            if _stand(placed, terrain, model, (x, y), facing + _slightly(rng, 0.15), margin_m):
                break


def _stand(
    placed: list[Placement], terrain: Terrain, model: Model, place: tuple[float, float], yaw: float,
    margin_m: float = 0.05,
) -> bool:  # fmt: skip
    upright = Placement(model=model, world_from_object=at_place(*place, 0.0, yaw))
    reach_m = _reach_m(model) + margin_m
    near = [
        one for one in placed if np.linalg.norm(one.world_from_object[:2, 3] - place) < reach_m + _reach_m(one.model)
    ]
    level = [Placement(model=one.model, world_from_object=_levelled(one.world_from_object)) for one in near]
    if not upright.fits(level, margin_m):
        return False
    placed.append(Placement(model=model, world_from_object=_on_ground(terrain, model, upright.world_from_object)))
    return True


def _reach_m(model: Model) -> float:
    return float(np.linalg.norm(np.abs(model.bounds_m()[:, :2]).max(axis=0)))


def _levelled(world_from_object: NDArray[np.float64]) -> NDArray[np.float64]:
    (x, y), (along, across) = world_from_object[:2, 3], world_from_object[:2, 0]
    return at_place(float(x), float(y), 0.0, float(np.arctan2(across, along)))


def _on_ground(terrain: Terrain, model: Model, upright: NDArray[np.float64]) -> NDArray[np.float64]:
    lower, upper = model.bounds_m()
    # Of objects set into the ground, only the part at ground level counts.
    reach = np.minimum(np.maximum(-lower[:2], upper[:2]), 0.25) if model.kind not in _TILTED else upper[:2] * 0.8
    corners = np.array([(sx * reach[0], sy * reach[1]) for sx in (-1, 1) for sy in (-1, 1)])
    places = corners @ upright[:2, :2].T + upright[:2, 3]
    heights = terrain.height_m(places)
    pose = upright.copy()
    if model.kind not in _TILTED:
        pose[2, 3] = float(heights.min()) + _REST_M
        return pose
    slope, _, _, _ = np.linalg.lstsq(np.column_stack([places - upright[:2, 3], np.ones(4)]), heights, rcond=None)
    up = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    forward = upright[:3, 0] - (upright[:3, 0] @ up) * up
    forward /= np.linalg.norm(forward)
    rotation = np.stack([forward, np.cross(up, forward), up], axis=1)
    return from_rotation_translation(rotation, np.array([*upright[:2, 3], slope[2] + _REST_M]))


def _crown(rng: np.random.Generator, trunk: Placement) -> Model:
    # Crowns are structure, in the world's frame.
    green = uniform(rng, 0.28, 0.42)
    leaves = Texture(
        pattern="speckle", first=(0.45 * green, green, 0.3 * green), second=(0.8 * green, 1.4 * green, 0.45 * green),
        period_m=0.06, grain=0.6,
    )  # fmt: skip
    x, y, z = trunk.world_from_object[:3, 3]
    half = (uniform(rng, 0.9, 1.5), uniform(rng, 0.9, 1.5), uniform(rng, 0.8, 1.2))
    ball = rough(ellipsoid(half, leaves), rng, 0.2, 0.9).moved((x, y, z + _CROWN_M + half[2]))
    # The stem goes on into the crown, above what a camera of short range sees of it.
    bark = trunk.model.parts[0].texture
    top = trunk.model.parts[0].vertices[-1] + (x, y, z)
    middle = np.array([x, y, z + _CROWN_M + half[2]])
    stem = tube([top - (0, 0, 0.02), (top + middle) / 2, middle], (0.08, 0.07, 0.05), bark)
    return Model(kind="crown", parts=(ball, stem))


def _houses(rng: np.random.Generator, terrain: Terrain) -> list[Model]:
    models = []
    front, low = terrain.front_m, -1.2
    x, end = -terrain.length_m / 2, terrain.length_m / 2
    while x < end:
        width = min(uniform(rng, 6.0, 9.0), end - x)
        if end - x - width < 4.0:
            width = end - x
        height, middle = uniform(rng, 6.0, 7.5), x + width / 2
        tone = uniform(rng, 0.5, 0.8)
        warm = uniform(rng, 0.0, 0.2)
        paint = Texture(
            pattern="tiles" if chance(rng, 0.5) else "plain", first=(tone, tone * (1 - warm), tone * (1 - 1.6 * warm)),
            second=(tone * 0.85, tone * (0.85 - warm), tone * (0.85 - 1.5 * warm)), period_m=0.24, grain=0.15,
        )  # fmt: skip
        ground = float(terrain.height_m(np.array([middle, front])))
        dark, frame = plain((0.3, 0.3, 0.3)), plain((0.86, 0.85, 0.82))
        parts = [
            block((width, 0.4, height - low), paint, at=(middle, front + 0.2, (height + low) / 2)),
            block((width, 0.06, 0.5 - low + ground), dark, at=(middle, front, (0.5 + low + ground) / 2)),
        ]
        at = x + 1.3
        while at < x + width - 1.1:
            if chance(rng, 0.3):
                parts.append(block((1.0, 0.08, 2.1), plain((0.35, 0.2, 0.13)), at=(at, front - 0.005, ground + 1.05)))
                parts.append(block((1.16, 0.05, 2.18), frame, at=(at, front, ground + 1.09)))
            else:
                parts.append(block((1.1, 0.05, 1.4), frame, at=(at, front, ground + 1.8)))
                parts.append(block((0.94, 0.06, 1.24), plain((0.2, 0.23, 0.27)), at=(at, front, ground + 1.8)))
                parts.append(block((1.25, 0.24, 0.06), frame, at=(at, front, ground + 1.07)))
            at += uniform(rng, 1.8, 2.4)
        models.append(Model(kind="wall", parts=tuple(parts)))
        x += width
    return models


def _daylight(rng: np.random.Generator) -> Lighting:
    turn, high = uniform(rng, 0, 2 * np.pi), uniform(rng, 35.0, 60.0)
    sun = Lamp(color=(0.62, 0.59, 0.52), near=1.0, far=0.0, shadow=0.12)
    fill = Lamp(color=(0.10, 0.11, 0.13), near=1.0, far=0.0, shadow=1.0)
    places = np.array([[[60 * np.cos(turn), 60 * np.sin(turn), high], [-40 * np.cos(turn), -40 * np.sin(turn), 40.0]]])
    return Lighting(places_m=places, lamps=(sun, fill), num_shadows=1, ambient=(0.42, 0.45, 0.5), sky=(0.68, 0.78, 0.9))
