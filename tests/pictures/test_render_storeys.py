from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.pictures.render import render_map
from hickory_stream.pictures.render_storeys import MARGIN_PX, MOST_STOREYS, Place, places_of, storeys_to_draw
from tests.engine.snapshot_fixtures import make_snapshot

STOREY_M = 3.0


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("storeys") / "m"
    folder = create_map_folder(path, config={}, source={"uri": "house.mcap"})
    folder.save(make_snapshot(folder))
    folder.finish(finished_cleanly=True)
    return open_map(path)


def at_height(tracked, new_id, z_m):
    """Return the object without a shape, so much higher."""
    up = np.array([0.0, 0.0, z_m])
    box = OrientedBox(
        world_from_box=from_rotation_translation(np.eye(3), up) @ tracked.box.world_from_box,
        half_extents_m=tracked.box.half_extents_m,
    )
    return replace(tracked, id=new_id, shape=None, box=box, points_world=tracked.points_world + up.astype(np.float32))


def house(snapshot, *counts):
    """Return storeys with so many objects each, the lowest at 0."""
    first = next(tracked for tracked in snapshot.objects if tracked.phase != "tentative")
    objects, submaps = [], []
    for storey, count in enumerate(counts):
        floor_m = storey * STOREY_M
        space = replace(snapshot.submaps[0].observed_space, floor_z_m=floor_m)
        submaps.append(replace(snapshot.submaps[0], id=storey, observed_space=space))
        base_m = floor_m - float(first.box.corners_world()[:, 2].min())
        objects += [at_height(first, len(objects) + i, base_m) for i in range(count)]
    return replace(snapshot, submaps=tuple(submaps), objects=tuple(objects))


def test_every_object_of_a_house_is_in_the_storeys_it_reaches(saved):
    snapshot = house(saved.snapshot, 2, 1, 3)
    pit = at_height(snapshot.objects[0], 99, -2.0)
    snapshot = replace(snapshot, objects=(*snapshot.objects, pit))
    storeys = storeys_to_draw(snapshot, None)
    assert [storey.floor_m for storey in storeys] == [0.0, STOREY_M, 2 * STOREY_M]
    assert [[tracked.id for tracked in storey.objects] for storey in storeys] == [[0, 1, 99], [2], [3, 4, 5]]


def test_one_storey_is_drawn_where_there_is_one_or_one_was_named(saved):
    (only,) = storeys_to_draw(saved.snapshot, None)
    assert only.floor_m is None
    assert len(only.objects) == sum(tracked.phase != "tentative" for tracked in saved.snapshot.objects)
    (named,) = storeys_to_draw(house(saved.snapshot, 2, 1), STOREY_M)
    assert [tracked.id for tracked in named.objects] == [2]


def test_of_a_tower_the_fullest_storeys_are_drawn_lowest_first(saved):
    storeys = storeys_to_draw(house(saved.snapshot, 1, 2, 1, 2, 2, 2, 2, 2), None)
    assert [storey.floor_m for storey in storeys] == [STOREY_M * i for i in (1, 3, 4, 5, 6, 7)]
    assert len(storeys) == MOST_STOREYS


@pytest.mark.parametrize("count", range(1, MOST_STOREYS + 1))
@pytest.mark.parametrize("size", [(1600, 756), (480, 196), (700, 2000)])
@pytest.mark.parametrize("extent", [(20.0, 4.0), (4.0, 20.0)])
def test_all_storeys_are_in_the_picture_without_overlap(count, size, extent):
    width, height = size
    covered = np.zeros((height, width), np.uint8)
    places = places_of(count, width, height, np.array(extent))
    assert len(places) == count
    for place in (view for views in places for view in views):
        assert place.x >= 0
        assert place.y >= 0
        part = place.of(covered)
        assert part.shape == (place.height, place.width)
        part += 1
        assert min(place.width, place.height) > 2 * place.margin_px + 20 or count == 1
    assert covered.max() == 1
    # Of five, a sixth place is empty.
    assert covered.mean() > (0.75 if count == 5 else 0.95)
    assert len({(above.width, above.height, above.margin_px) for above, _ in places}) == 1


def test_a_single_storey_has_its_views_beside_each_other():
    ((above, corner),) = places_of(1, 1600, 756, np.array([30.0, 10.0]))
    assert above == Place(x=0, y=0, width=736, height=756, margin_px=MARGIN_PX)
    assert corner == Place(x=738, y=0, width=862, height=756, margin_px=MARGIN_PX)


def test_the_lower_floor_is_seen_below_an_equal_upper_one(saved):
    lower = house(saved.snapshot, 1, 1)
    first, second = lower.objects
    red, blue = (np.full_like(first.colors, color) for color in ((220, 20, 20), (20, 20, 220)))
    objects = (replace(first, colors=red), replace(second, colors=blue))
    image = render_map(replace(saved, snapshot=replace(lower, objects=objects)), {1}, (960, 500)).astype(int)
    for half, channel in ((image[70:, :479], 0), (image[70:, 482:], 2)):
        colored = half[..., channel] > half[..., 2 - channel] + 60
        other = half[..., 2 - channel] > half[..., channel] + 60
        assert colored.sum() > 200 > 4 * other.sum()
