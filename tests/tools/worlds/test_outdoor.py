from collections import Counter
from itertools import pairwise
import numpy as np
import pytest
from hickory_stream.geometry.mesh import is_closed
from hickory_stream.geometry.rigid import is_rigid
from hickory_stream.worlds.clearance import clearance_of
from hickory_stream.worlds.rendering import Renderer
from hickory_stream.worlds.trajectory import NoWalk, WalkConfig
from tests.shapes.shape_fixtures import as_mesh
from tools.worlds.outdoor import street_things
from tools.worlds.outdoor.street import street
from tools.worlds.outdoor.walk import outdoors, stroll
from tools.worlds.recording_config import RecordingConfig, walkable_world

SEEDS = (2, 77)
RECIPES = [
    street_things.car, street_things.trunk, street_things.park_bench, street_things.bollard, street_things.litter_bin,
    street_things.wheeled_bin, street_things.hydrant, street_things.crate, street_things.boulder, street_things.planter,
    street_things.sign_post, street_things.junction_box,
]  # fmt: skip


@pytest.fixture(scope="module")
def streets():
    return [street(seed) for seed in SEEDS]


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda recipe: recipe.__name__)
def test_outdoor_things_are_closed_and_face_outwards(recipe):
    for seed in (1, 2):
        model = recipe(np.random.default_rng(seed))
        lower, upper = model.bounds_m()
        assert -0.45 < lower[2] <= 0.05
        assert upper[2] > 0.2
        for part in model.parts:
            assert is_closed(as_mesh(part))
            a, b, c = (part.vertices[part.faces[:, i]] for i in range(3))
            assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0


def test_a_street_has_its_things_on_uneven_ground(streets):
    for found in streets:
        kinds = Counter(item.model.kind for item in found.world.objects)
        assert sum(kinds.values()) >= 22
        assert kinds["car"] >= 1
        assert kinds["trunk"] >= 5
        assert {"park_bench", "bollard"} <= set(kinds)
        x0, y0, x1, y1 = found.world.interior_m
        grid = np.stack(np.meshgrid(np.linspace(x0, x1, 60), np.linspace(y0, y1, 60)), axis=-1)
        assert np.ptp(found.terrain.height_m(grid)) > 0.5
        structure = Counter(model.kind for model in found.world.structure)
        assert structure["kerb"] == 2
        assert structure["crown"] == kinds["trunk"]
        assert {"road", "pavement", "lawn", "wall"} <= set(structure)


def test_a_kerb_is_a_step_but_at_crossings_and_things_stand(streets):
    for found in streets:
        terrain = found.terrain
        for kerb, inwards in zip(terrain.kerbs_m, (1, -1), strict=True):
            for x, least, most in ((0.0, 0.1, 0.16), (terrain.crossings_m[0], 0.0, 0.04)):
                low, high = (terrain.height_m(np.array([x, kerb + side * 1e-6])) for side in (inwards, -inwards))
                assert least <= high - low <= most
        for item in found.world.objects:
            assert is_rigid(item.world_from_object)
            vertices = np.concatenate([part.vertices for part in item.model.parts])
            world = vertices @ item.world_from_object[:3, :3].T + item.world_from_object[:3, 3]
            above = world[:, 2] - found.terrain.height_m(world[:, :2])
            assert -0.6 < above.min() < 0.03, item.model.kind


def test_one_walks_over_kerbs_at_eye_height(streets):
    config = WalkConfig()
    for found in streets:
        walks = [stroll(found, 60.0, config, i) for i in (0, 1)]
        for walk in walks:
            assert not isinstance(walk, NoWalk)
            places = walk.world_from_camera[:, :3, 3]
            assert clearance_of(found.world).at(places[:, :2]).min() > 0.1
            height = places[:, 2] - found.terrain.height_m(places[:, :2])
            assert np.abs(height - config.eye_height_m).max() < 0.15
            on = {found.terrain.kerbs_m[0] < y < found.terrain.kerbs_m[1] for y in places[:, 1]}
            assert on == {True, False}, "it goes over the road, and beside it"
        assert not np.allclose(walks[0].world_from_camera[600], walks[1].world_from_camera[600])


def test_a_frame_of_a_street_has_sky_in_colour_and_none_in_depth():
    config = outdoors(RecordingConfig(scene="outdoor", seed=5, seconds=2.0, rate_hz=1.0, width=96, height=72))
    assert config.depth.max_depth_m < 8
    world, walk = walkable_world(config)
    again, _ = walkable_world(config)
    for one, other in pairwise([world, again]):
        for a, b in zip(one.objects, other.objects, strict=True):
            assert a.model.kind == b.model.kind
            assert np.array_equal(a.world_from_object, b.world_from_object)
    seen = Renderer(world).render(config.camera, walk.pose_at(0.0))
    is_sky = ~np.isfinite(seen.depth_m)
    assert 0.02 < is_sky.mean() < 0.7
    assert (seen.rgb[is_sky].mean(axis=0) > 120).all()
