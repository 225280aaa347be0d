"""A seeded simulator of pairs of overlapping object maps with outliers, noise and tilt."""
# Objects stand in 2.5 m^2 each, up to 1.5 m high; outliers are in one map alone. Each map sees them with its own noise:
# 5 cm an axis, exponents +-0.1, semi-axes +-6 %, lost primitives. Cosines of descriptors have the wanted means and
# spreads: without the spread a threshold would solve everything.

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.object_map import ObjectMap
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.rigid import (
    apply,
    from_rotation_translation,
    invert,
    rotation_from_quaternion,
    yaw_rotation,
)
from hickory_stream.geometry.superquadric import (
    MAX_EXPONENT,
    MIN_EXPONENT,
    Superquadrics,
    centroid_world,
    moved,
    sorted_by_volume,
    support_reach,
    taken,
)

Difficulty = Literal["easy", "hard"]

_AREA_PER_OBJECT_M2, _HEIGHT_M, _NOISE_M = 2.5, 1.5, 0.05
_EXPONENT_NOISE, _AXIS_NOISE, _LOST = 0.1, 0.06, 0.15
# Differences between two instances of a class in a hard map: as small as between two views of one object.
_INSTANCE_EXPONENTS, _INSTANCE_AXES = 0.05, 0.05


@dataclass(frozen=True, kw_only=True, slots=True)
class SimulationConfig:
    """One pair of maps."""

    # `num_objects` in each map, of which the share `outliers` has no counterpart in the other; `tilt_deg` is the angle
    # between the verticals of the two maps, about a random horizontal axis. `easy`: 25 classes, in which every object
    # has its own shape. `hard`: 6 classes of one shape each, with nearly identical instances.
    num_objects: int = 40
    outliers: float = 0.75
    difficulty: Difficulty = "easy"
    tilt_deg: float = 0.0

    def __post_init__(self) -> None:
        if self.num_objects < 0 or not 0 <= self.outliers <= 1:
            raise ValueError(f"expected objects and a share of outliers in 0..1, found {self}")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SimulatedPair:
    """Two maps and their truth: `a_from_b` (4, 4), the indices (K, 2) of common objects, their true positions in a."""

    map_a: ObjectMap
    map_b: ObjectMap
    a_from_b: NDArray[np.float64]
    common: NDArray[np.int64]
    common_centroids_a: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Descriptors:
    """The model of descriptors: the shares of the squared norm common to all objects, to a class, and to an instance.

    The number of dimensions of a part sets the spread of its cosines, 1 / sqrt(dimensions). `noise` is the mean share
    of the part of a single observation, and `noise_shape` the shape parameter of its gamma distribution.
    """

    classes: int
    common: float
    per_class: float
    per_instance: float
    noise: float
    class_dimensions: int
    instance_dimensions: int
    noise_dimensions: int
    noise_shape: float


# Means of the cosines: same object 1 - noise, same class common + per_class, other common, each times (1 - noise).
_DESCRIPTORS = {
    "easy": _Descriptors(
        classes=25, common=0.266, per_class=0.532, per_instance=0.202, noise=0.06, class_dimensions=17,
        instance_dimensions=7, noise_dimensions=12, noise_shape=0.75,
    ),
    "hard": _Descriptors(
        classes=6, common=0.269, per_class=0.720, per_instance=0.011, noise=0.07, class_dimensions=40,
        instance_dimensions=7, noise_dimensions=12, noise_shape=4.0,
    ),
}  # fmt: skip


def simulate_pair(config: SimulationConfig, seed: int) -> SimulatedPair:
    """Return two maps of one place; the same seed gives the same maps."""
    rng = np.random.default_rng([seed, 8])
    count = config.num_objects
    num_common = round(count * (1 - config.outliers))
    side_m = np.sqrt(_AREA_PER_OBJECT_M2 * max(count, 1))
    world = SimulatedWorld(config.difficulty, rng)
    total = 2 * count - num_common
    places = rng.uniform([0, 0, 0], [side_m, side_m, _HEIGHT_M], (total, 3)) - [side_m / 2, side_m / 2, 0]
    objects = [world.new_object(place) for place in places]
    a_from_world, b_from_world = random_pose(config.tilt_deg, side_m, rng), random_pose(0.0, side_m, rng)
    in_a, in_b = np.arange(count), np.concatenate([np.arange(num_common), np.arange(count, total)])
    order_a, order_b = rng.permutation(in_a), rng.permutation(in_b)
    rank_a, rank_b = np.argsort(order_a), {int(item): i for i, item in enumerate(order_b)}
    return SimulatedPair(
        map_a=world.observe([objects[i] for i in order_a], a_from_world),
        map_b=world.observe([objects[i] for i in order_b], b_from_world),
        a_from_b=a_from_world @ invert(b_from_world),
        common=np.array([[rank_a[i], rank_b[i]] for i in range(num_common)], dtype=np.int64).reshape(-1, 2),
        common_centroids_a=apply(a_from_world, places[:num_common]),
    )


def simulate_unrelated(config: SimulationConfig, seed: int) -> SimulatedPair:
    """Return two maps of different places: no object in common, the same classes."""
    return simulate_pair(
        SimulationConfig(num_objects=config.num_objects, outliers=1.0, difficulty=config.difficulty), seed
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SimulatedObject:
    """A true object: its shape in the world, and what a descriptor of it is without noise."""

    shape: Superquadrics
    signal: NDArray[np.float64]

    @property
    def place(self) -> NDArray[np.float64]:
        return centroid_world(self.shape)

    def moved(self, there_from_here: NDArray[np.float64]) -> "SimulatedObject":
        """Return the same model at another place: `there_from_here` (4, 4)."""
        return SimulatedObject(shape=moved(self.shape, there_from_here), signal=self.signal)


class SimulatedWorld:
    """The classes of a world, and the random generator of everything in it."""

    def __init__(self, difficulty: Difficulty, rng: np.random.Generator) -> None:
        self._difficulty = difficulty
        self._parts = _DESCRIPTORS[difficulty]
        self._rng = rng
        self._common = _direction(rng, 1)
        self._classes = [_direction(rng, self._parts.class_dimensions) for _ in range(self._parts.classes)]
        self._class_shapes = rng.integers(len(real_fits()), size=self._parts.classes)

    def new_object(self, place: NDArray[np.float64]) -> "SimulatedObject":
        rng = self._rng
        class_index = int(rng.integers(self._parts.classes))
        signal = self._signal(class_index)
        if self._difficulty == "easy":
            shape = real_fits()[int(rng.integers(len(real_fits())))]
        else:
            shape = _varied(real_fits()[self._class_shapes[class_index]], _INSTANCE_EXPONENTS, _INSTANCE_AXES, rng)
        turned = moved(shape, from_rotation_translation(yaw_rotation(rng.uniform(0, 2 * np.pi)), np.zeros(3)))
        return SimulatedObject(shape=_centered(turned, place), signal=signal)

    def object_of(self, shape: Superquadrics, kind: int) -> "SimulatedObject":
        return SimulatedObject(shape=shape, signal=self._signal(kind % self._parts.classes))

    def _signal(self, class_index: int) -> NDArray[np.float64]:
        parts = self._parts
        return np.concatenate([
            np.sqrt(parts.common) * self._common, np.sqrt(parts.per_class) * self._classes[class_index],
            np.sqrt(parts.per_instance) * _direction(self._rng, parts.instance_dimensions),
        ])  # fmt: skip

    def observe(self, objects: list[SimulatedObject], map_from_world: NDArray[np.float64]) -> ObjectMap:
        shapes = tuple(self._observed_shape(item, map_from_world) for item in objects)
        features = np.array([self._observed_descriptor(item) for item in objects], dtype=np.float32)
        return ObjectMap(
            ids=np.arange(len(objects)), centroids=np.array([centroid_world(shape) for shape in shapes]).reshape(-1, 3),
            features=features if len(objects) else None, shapes=shapes, boxes=tuple(_box(shape) for shape in shapes),
            points=(None,) * len(objects),
        )  # fmt: skip

    def pair(
        self, objects: list[SimulatedObject], in_a: NDArray[np.int64], in_b: NDArray[np.int64],
        a_from_world: NDArray[np.float64], b_from_world: NDArray[np.float64],
    ) -> SimulatedPair:  # fmt: skip
        """Return two maps of these objects; `in_a` and `in_b` are the indices of what each has, in its order."""
        both, rank_a, rank_b = np.intersect1d(in_a, in_b, return_indices=True)
        places = np.array([objects[i].place for i in both]).reshape(-1, 3)
        return SimulatedPair(
            map_a=self.observe([objects[i] for i in in_a], a_from_world),
            map_b=self.observe([objects[i] for i in in_b], b_from_world),
            a_from_b=a_from_world @ invert(b_from_world),
            common=np.stack([rank_a, rank_b], axis=1).astype(np.int64),
            common_centroids_a=apply(a_from_world, places),
        )

    def _observed_shape(self, item: SimulatedObject, map_from_world: NDArray[np.float64]) -> Superquadrics:
        rng = self._rng
        varied = _varied(item.shape, _EXPONENT_NOISE, _AXIS_NOISE, rng)
        kept = rng.random(len(varied)) >= _LOST
        kept[0] |= not kept.any()
        place = centroid_world(item.shape) + rng.normal(0, _NOISE_M, 3)
        seen = sorted_by_volume(taken(varied, np.flatnonzero(kept)))
        return moved(_centered(seen, place), map_from_world)

    def _observed_descriptor(self, item: SimulatedObject) -> NDArray[np.float64]:
        parts, rng = self._parts, self._rng
        share = min(float(rng.gamma(parts.noise_shape, parts.noise / parts.noise_shape)), 0.9)
        noise = _direction(rng, parts.noise_dimensions)
        return np.concatenate([np.sqrt(1 - share) * item.signal, np.sqrt(share) * noise])


@cache
def real_fits() -> tuple[Superquadrics, ...]:
    """Return layer 3 of the objects of two apartments, fitted by the pipeline, with centroids at the origin."""
    with files("tools.evaluation.simulated_maps").joinpath("shapes.npz").open("rb") as file, np.load(file) as data:
        counts, exponents, semi_axes = data["counts"], data["exponents"], data["semi_axes_m"]
        centers, quaternions = data["centers_m"], data["quaternions"]
    starts = np.concatenate([[0], np.cumsum(counts)])
    fits = []
    for start, end in pairwise(starts):
        poses = [
            from_rotation_translation(rotation_from_quaternion(*(float(c) for c in quaternions[i])), centers[i])
            for i in range(start, end)
        ]
        fits.append(
            Superquadrics(
                exponents=np.clip(exponents[start:end].astype(np.float64), MIN_EXPONENT, MAX_EXPONENT),
                semi_axes_m=semi_axes[start:end].astype(np.float64),
                world_from_local=np.array(poses),
            )
        )
    return tuple(fits)


def _varied(shape: Superquadrics, exponents: float, axes: float, rng: np.random.Generator) -> Superquadrics:
    return Superquadrics(
        exponents=np.clip(
            shape.exponents + rng.normal(0, exponents, shape.exponents.shape), MIN_EXPONENT, MAX_EXPONENT
        ),
        semi_axes_m=shape.semi_axes_m * np.exp(rng.normal(0, axes, shape.semi_axes_m.shape)),
        world_from_local=shape.world_from_local,
    )


def _centered(shape: Superquadrics, place: NDArray[np.float64]) -> Superquadrics:
    return moved(shape, from_rotation_translation(np.eye(3), place - centroid_world(shape)))


def _box(shape: Superquadrics) -> OrientedBox:
    centers, reach = shape.world_from_local[:, :3, 3], support_reach(shape, np.eye(3))
    low, high = (centers - reach).min(axis=0), (centers + reach).max(axis=0)
    return OrientedBox(
        world_from_box=from_rotation_translation(np.eye(3), (low + high) / 2), half_extents_m=(high - low) / 2
    )


def _direction(rng: np.random.Generator, dimensions: int) -> NDArray[np.float64]:
    vector = rng.standard_normal(dimensions)
    return np.ones(1) if dimensions == 1 else np.asarray(vector / np.linalg.norm(vector))


def random_pose(tilt_deg: float, side_m: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return `map_from_world` of a robot that starts at a random place of the square, looking anywhere."""
    # Its idea of gravity is off by `tilt_deg` about a random level axis.
    from scipy.spatial.transform import Rotation

    azimuth, yaw = rng.uniform(0, 2 * np.pi, 2)
    tilt = Rotation.from_rotvec(np.radians(tilt_deg) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])).as_matrix()
    start = np.array([*rng.uniform(-side_m / 2, side_m / 2, 2), 0.0])
    rotation = tilt @ yaw_rotation(yaw)
    return from_rotation_translation(rotation, -rotation @ start)


@dataclass(frozen=True, kw_only=True, slots=True)
class FleetMapsConfig:
    """`num_maps` of about `num_objects` each, each of a square at a random place."""

    # The place is so large that a map overlaps about `overlaps` others; `seen` is the share of the objects there that a
    # robot has found.
    num_maps: int = 20
    num_objects: int = 40
    overlaps: float = 4.0
    seen: float = 0.7
    difficulty: Difficulty = "hard"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FleetMaps:
    """The maps, and how many objects each two (a, b), a < b, have in common, where they have any."""

    maps: tuple[ObjectMap, ...]
    common: dict[tuple[int, int], int]


def simulate_fleet(config: FleetMapsConfig, seed: int) -> FleetMaps:
    rng = np.random.default_rng([seed, 9])
    world = SimulatedWorld(config.difficulty, rng)
    side = float(np.sqrt(_AREA_PER_OBJECT_M2 * config.num_objects / config.seen))
    # Two squares of side s at random in one of side S touch with a chance of about (2 s / S)^2.
    whole = max(side, 2 * side * float(np.sqrt((config.num_maps - 1) / config.overlaps)))
    total = round((whole + side) ** 2 / _AREA_PER_OBJECT_M2)
    places = rng.uniform([0, 0, 0], [whole + side, whole + side, _HEIGHT_M], (total, 3))
    objects = [world.new_object(place) for place in places]
    maps, seen = [], []
    for low in rng.uniform(0, whole, (config.num_maps, 2)):
        inside = ((places[:, :2] >= low) & (places[:, :2] < low + side)).all(axis=1)
        found = rng.permutation(np.flatnonzero(inside & (rng.random(total) < config.seen)))
        maps.append(world.observe([objects[i] for i in found], random_pose(0.0, side, rng)))
        seen.append(set(found.tolist()))
    common = {
        (a, b): len(seen[a] & seen[b]) for a in range(len(seen)) for b in range(a + 1, len(seen)) if seen[a] & seen[b]
    }
    return FleetMaps(maps=tuple(maps), common=common)
