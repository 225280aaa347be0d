import cv2
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rerun.chunk import RrdReader
from hickory_stream.records import Phase
from hickory_stream.sinks.rerun.config import RerunConfig
from hickory_stream.sinks.rerun.eye import MAIN_ASPECT, SIDE_ASPECT, eye_on
from hickory_stream.sinks.rerun.labels import MEANINGS, label_size, label_threads
from hickory_stream.sinks.rerun.sink import RerunSink, parse_viewer
from tests.sinks.report_fixtures import reports


def arrangement_of(path):
    """Return by the name of a view what the last arrangement of a file says of it: entity below the view -> columns."""
    reader = RrdReader(path)
    stores = []
    for store in reader.blueprints():
        entities = {}
        sent_ns = 0
        for chunk in reader.stream(store=store):
            batch = chunk.to_record_batch()
            columns = {name: batch.column(name).to_pylist()[-1] for name in batch.schema.names if ":" in name}
            entities.setdefault(chunk.entity_path, {}).update(columns)
            if "log_time" in batch.schema.names:
                sent_ns = max(sent_ns, *batch.column("log_time").cast(pa.int64()).to_pylist())
        stores.append((sent_ns, entities))
    _, last = max(stores, key=lambda store: store[0])
    views = {path: columns for path, columns in last.items() if "ViewBlueprint:display_name" in columns}
    return {
        columns["ViewBlueprint:display_name"][0]: {
            path.removeprefix(f"{view}/"): columns for path, columns in last.items() if path.startswith(f"{view}/")
        }
        for view, columns in views.items()
    }


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arrangement")
    sink = RerunSink(RerunConfig(), folder, folder / "run.rrd", parse_viewer("none"))
    *_, last = (sink.show(report) or report for report in reports(9, folder, width=96))
    sink.close()
    return folder / "run.rrd", last.snapshot


@pytest.fixture(scope="module")
def views(played):
    return arrangement_of(played[0])


@pytest.fixture(scope="module")
def corners_of_the_map(played):
    return np.concatenate([o.box.corners_world() for o in played[1].objects if o.phase is not Phase.TENTATIVE])


MAPS = {
    "Layers 1 and 2: points, boxes, meshes": MAIN_ASPECT,
    "Layer 3: superquadrics": SIDE_ASPECT,
    "Layer 4: inflated, over the meshes": SIDE_ASPECT,
}


@pytest.mark.parametrize(("name", "aspect"), MAPS.items())
def test_the_map_fills_its_view_from_rim_to_rim(views, corners_of_the_map, name, aspect):
    eye = views[name]["EyeControls3D"]
    position, target = (np.array(eye[f"EyeControls3D:{end}"][0]) for end in ("position", "look_target"))
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, (0, 0, 1)) / np.linalg.norm(np.cross(forward, (0, 0, 1)))
    offsets = corners_of_the_map - position
    # The viewer's angle of view is 55 degrees from top to bottom.
    reach = np.column_stack([offsets @ right / aspect, offsets @ np.cross(right, forward)])
    shares = reach / (offsets @ forward)[:, None] / np.tan(np.deg2rad(27.5))
    assert np.abs(shares).max() <= 0.9 + 1e-6
    assert np.ptp(shares, axis=0).max() == pytest.approx(1.8, abs=0.01)


def test_filled_boxes_are_hidden_until_they_are_switched_on(views):
    main = views["Layers 1 and 2: points, boxes, meshes"]
    assert "+ world/filled/**" in main["ViewContents"]["ViewContents:query"]
    assert main["ViewContents/overrides/world/filled/visualizers"] == {"EntityBehavior:visible": [False]}
    assert not any(
        "filled" in query for name in list(MAPS)[1:] for query in views[name]["ViewContents"]["ViewContents:query"]
    )


def test_decisions_on_objects_come_first_and_scores_on_demand(views):
    names = ["Merges, drops, splits, confirmations", "All decisions, with scores of views", "Decisions by object"]
    levels = [views[name].get("TextLogRows", {}).get("TextLogRows:filter_by_log_level") for name in names]
    assert levels == [["WARN", "INFO"], None, None]


def test_a_legend_of_colours_is_beside_them(played, views):
    assert views["Legend"]["ViewContents"]["ViewContents:query"] == ["$origin/**"]
    (blob,) = [c.to_record_batch() for c in RrdReader(played[0]).stream() if c.entity_path == "/legend"]
    image = cv2.imdecode(np.array(blob.column("EncodedImage:blob").to_pylist()[0][0], np.uint8), cv2.IMREAD_COLOR)
    pixels = set(map(tuple, image[..., ::-1].reshape(-1, 3).tolist()))
    assert {color for _, color in MEANINGS} <= pixels


def test_all_best_views_lie_within_the_sheet_that_is_shown(views):
    shown = views["Best views"]["VisualBounds2D"]["VisualBounds2D:range"][0]
    assert shown["x_range"][0] == shown["y_range"][0] == 0.0
    assert shown["x_range"][1] >= 7 * 128
    assert shown["y_range"][1] >= 128


place = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(0, 2))


@given(st.lists(place, min_size=1, max_size=20))
def test_labels_of_close_things_do_not_overlap_for_the_first_eye(places):
    tops = np.array(places)
    texts = [str(7 * i) for i in range(len(tops))]
    eye = eye_on(np.concatenate([tops, tops * (1, 1, 0)]), MAIN_ASPECT)
    threads = label_threads(tops, texts, eye)
    assert np.array_equal(threads[:, 0], tops)
    assert (np.diff(threads[:, :, 2], axis=1) > 0).all()
    bottom, top = eye.project(threads[:, 1]), eye.project(threads[:, 2])
    half = np.array([label_size(text)[0] for text in texts]) / 2
    for i in range(len(tops)):
        for j in range(i):
            is_beside = abs(top[i, 0] - top[j, 0]) >= 0.85 * (half[i] + half[j])
            high, low = max(top[i, 1], top[j, 1]), min(bottom[i, 1], bottom[j, 1])
            # A perspective is not quite linear in height: a fifth of a label is let through.
            assert is_beside or low - high < 0.2 * 0.036
