"""Hypothesis strategies of geometry and records: in one place, so that every law meets the same degenerate cases."""

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics, log_implicit_value
from hickory_stream.mapping.entities.cloud import cloud_of
from hickory_stream.records import View

coordinate = st.floats(-20, 20)
unit_share = st.floats(0, 1)
seeds = st.integers(0, 2**32 - 1)


@st.composite
def rotations(draw):
    """Rotations of any axis; none, quarter and half turns, and those just beside them come often."""
    axis = np.array(draw(st.tuples(*[st.floats(-1, 1)] * 3)))
    if np.linalg.norm(axis) < 1e-3:
        axis = np.eye(3)[draw(st.integers(0, 2))]
    special = st.sampled_from([0.0, 1e-12, 1e-7, 1e-4, np.pi / 2, np.pi - 1e-4, np.pi - 1e-7, np.pi - 1e-12, np.pi])
    angle = draw(st.one_of(special, st.floats(0, np.pi)))
    return np.asarray(Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix())


@st.composite
def rigid_transforms(draw):
    return from_rotation_translation(draw(rotations()), np.array(draw(st.tuples(*[coordinate] * 3))))


@st.composite
def oriented_boxes(draw, reach_m=0.6, smallest_m=0.05):
    """Boxes of any orientation with half extents up to 1 m, centred near the origin: two of them mostly overlap."""
    center = np.array(draw(st.tuples(*[st.floats(-reach_m, reach_m)] * 3)))
    half = np.array(draw(st.tuples(*[st.floats(smallest_m, 1.0)] * 3)))
    return OrientedBox(world_from_box=from_rotation_translation(draw(rotations()), center), half_extents_m=half)


@st.composite
def point_sets(draw, max_points=40):
    """A blob, a plane, a line or a spot of at least one point, some of them twice, near the origin or far away."""
    rng = np.random.default_rng(draw(seeds))
    spread = np.array(
        draw(st.sampled_from([(1, 1, 1), (1, 1, 0), (1, 0, 0), (0, 0, 1), (0, 0, 0), (1, 1e-9, 1), (3, 0.01, 1)]))
    )
    points = rng.normal(size=(draw(st.integers(1, max_points)), 3)) * spread
    points = np.concatenate([points, points[: draw(st.integers(0, 3))]])
    middle = np.array(draw(st.sampled_from([(0, 0, 0), (40, -30, 2)])))
    return np.asarray(points @ draw(rotations()).T + middle)


def integer_cells(largest=2**20 - 2, max_size=60):
    """(N, 3) voxel coordinates, negative ones and the ends of the lattice among them."""
    number = st.one_of(st.integers(-3, 3), st.integers(-largest, largest), st.sampled_from([-largest, largest]))
    rows = st.lists(st.tuples(number, number, number), max_size=max_size)
    return rows.map(lambda values: np.array(values, dtype=np.int64).reshape(-1, 3))


@st.composite
def frame_clouds(draw, voxel_m=0.01):
    """Clouds of one frame's points in a dense decimetre: two of them share many voxels."""
    rng = np.random.default_rng(draw(seeds))
    count = draw(st.integers(1, 200))
    points = rng.uniform(-0.05, 0.05, (count, 3)).astype(np.float32)
    return cloud_of(points, rng.integers(0, 256, (count, 3), dtype=np.uint8), voxel_m)


@st.composite
def cameras(draw):
    width, height = draw(st.integers(8, 64)), draw(st.integers(8, 64))
    return Camera(
        width=width, height=height, fx=draw(st.floats(10, 900)), fy=draw(st.floats(10, 900)),
        cx=draw(st.floats(0, width)), cy=draw(st.floats(0, height)),
    )  # fmt: skip


@st.composite
def views(draw, frame_index=None):
    x0, y0 = draw(st.integers(0, 100)), draw(st.integers(0, 100))
    return View(
        object_id=1, frame_index=draw(st.integers(0, 500)) if frame_index is None else frame_index, stamp_ns=0,
        box_px=(x0, y0, x0 + draw(st.integers(1, 400)), y0 + draw(st.integers(1, 400))), world_from_camera=np.eye(4),
        r_area=draw(unit_share), r_depth=draw(unit_share), box_volume_m3=draw(st.floats(1e-6, 10)), score=None,
        variance=None, feature=None,
    )  # fmt: skip


def quadric(exponents, semi_axes_m, world_from_local=None):
    """One primitive, at the origin unless a pose is given."""
    pose = np.eye(4) if world_from_local is None else world_from_local
    return Superquadrics(
        exponents=np.array([exponents], dtype=float), semi_axes_m=np.array([semi_axes_m], dtype=float),
        world_from_local=pose[None],
    )  # fmt: skip


def radial_distance_m(primitive, points):
    """Signed distances (N,) to the surface of the first primitive, on rays from its centre; negative inside."""
    far_m = np.linalg.norm(np.asarray(points, dtype=float) - primitive.world_from_local[0, :3, 3], axis=1)
    return far_m * (1 - np.exp(-primitive.exponents[0, 0] / 2 * log_implicit_value(primitive, 0, points)))
