from dataclasses import replace
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.display import color_of_id
from hickory_stream.pictures.labels import draw_labels, most_visible, place_labels
from hickory_stream.pictures.render import labels_of
from hickory_stream.pictures.render_parts import dots_of
from hickory_stream.pictures.viewpoint import from_above, from_corner
from tests.engine.snapshot_fixtures import box_mesh, make_object, placed

STEP_PX = 4


def overlaps(labels):
    boxes = [label.box_px for label in labels]
    return sum(
        a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3] for i, a in enumerate(boxes) for b in boxes[:i]
    )


def owners_of(*squares, shape=(100, 150)):
    """Return whose surface is seen: squares (id, column, row, side), later ones over earlier ones."""
    owners = np.full(shape, -1, np.int32)
    for object_id, column, row, side in squares:
        owners[row : row + side, column : column + side] = object_id
    return owners


square = st.tuples(st.integers(0, 149), st.integers(0, 99), st.integers(1, 40))


@given(st.lists(square, min_size=1, max_size=20))
def test_no_label_covers_another_or_leaves_the_picture(squares):
    ids = list(range(3, 3 + len(squares)))
    owners = owners_of(*((i, *found) for i, found in zip(ids, squares, strict=True)))
    hidden = np.array([(STEP_PX * x, STEP_PX * y) for x, y, _ in squares], dtype=float)
    labels = place_labels(ids, owners, STEP_PX, hidden)
    assert [label.object_id for label in labels] == ids
    assert overlaps(labels) == 0
    boxes = np.array([label.box_px for label in labels])
    assert (boxes >= 0).all()
    assert (boxes[:, 2:] <= (600, 400)).all()


def test_a_label_is_inside_a_large_object_and_beside_a_small_one():
    owners = owners_of((1, 10, 10, 40), (2, 28, 28, 3))
    large, small = place_labels([1, 2], owners, STEP_PX, np.zeros((2, 2)))
    assert not large.is_beside
    x0, y0, x1, y1 = (end // STEP_PX for end in large.box_px)
    assert (owners[y0 : y1 + 1, x0 : x1 + 1] == 1).all()
    assert small.is_beside
    assert owners[small.place_px[1] // STEP_PX, small.place_px[0] // STEP_PX] == 2
    image = np.full((400, 600, 3), 255, np.uint8)
    draw_labels(image, [large, small])
    dark = tuple(int(0.55 * c) for c in color_of_id(2))
    assert (image[small.box_px[1], small.box_px[0]] == dark).all()
    assert (image[small.place_px[1], small.place_px[0]] == dark).all()


def test_an_object_seen_through_rungs_is_labelled_where_visible():
    # Object 2 shows at the right of object 1, which hides its middle.
    owners = owners_of((2, 20, 20, 40), (1, 10, 10, 40))
    label = place_labels([1, 2], owners, STEP_PX, np.zeros((2, 2)))[1]
    assert owners[label.place_px[1] // STEP_PX, label.place_px[0] // STEP_PX] == 2


def test_stacked_objects_are_labelled_apart_in_both_views():
    heights = {1: 0.7, 2: 0.12, 3: 0.1, 4: 0.08}
    places = {1: (0.0, 0.0, 0.35), 2: (0.0, 0.0, 0.76), 3: (0.05, 0.0, 0.87), 4: (0.02, 0.03, 0.96)}
    objects = []
    for i, place in places.items():
        side = 1.2 if i == 1 else 0.12
        made = make_object(i, box_mesh((side, side, heights[i]), (120, 90, 60)), placed(*place))
        objects.append(replace(made, id=i))
    corners = np.concatenate([tracked.box.corners_world() for tracked in objects])
    for viewpoint in (from_above(corners, 300, 240, 30), from_corner(corners, 0.4, 0.66, 300, 240, 30)):
        labels = labels_of(viewpoint, objects, [dots_of(tracked) for tracked in objects])
        assert [label.object_id for label in labels] == [1, 2, 3, 4]
        assert overlaps(labels) == 0


def test_a_crowd_labels_the_most_visible_and_a_room_all():
    owners = np.full((120, 200), -1, dtype=np.int32)
    # 100 things: the first ten have squares of 30 x 30 pixels, the others of 3 x 3.
    for k in range(10):
        owners[:10, 12 * k : 12 * k + 10] = k
    for k in range(10, 100):
        owners[20 + 2 * (k // 10), 4 * (k % 10)] = k
    chosen = most_visible(range(100), owners, STEP_PX)
    assert len(chosen) == 30
    assert set(range(10)) <= set(chosen)
    assert sorted(most_visible(range(20), owners, STEP_PX)) == list(range(20))
    everywhere = np.arange(120 * 200, dtype=np.int32).reshape(120, 200) % 40
    assert sorted(most_visible(range(40), everywhere, STEP_PX)) == list(range(40))
