import shutil
from collections import Counter
import numpy as np
from hickory_stream.evaluation.evaluate import true_mesh_world
from hickory_stream.evaluation.match import TrueBox
from hickory_stream.evaluation.reach import depth_on_labels, depth_on_objects
from hickory_stream.evaluation.truth import frame_at, instances_of, load_truth
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.map_folder.history.recorded import frame_indices
from hickory_stream.map_folder.saved_map import open_map
from players import open_source


def test_keyframes_count_where_the_log_has_depth_on_a_thing(short_map, short_log, demo_truth):
    saved, truth = open_map(short_map), load_truth(demo_truth)
    stamps = np.array([frame.stamp_ns for frame in truth.frames])
    least, most = Counter(), Counter()
    for frame in (one.decode() for one in open_source(str(short_log)).frames()):
        if frame.index in frame_indices(short_map)[0]:
            shown = instances_of(truth, truth.frames[frame_at(stamps, frame.stamp_ns)])
            cells = Counter((shown[frame.depth_m > 0]).tolist())
            least.update(i for i, px in cells.items() if px >= 12 * (frame.camera.width // 160) ** 2)
            most.update(i for i, px in cells.items() if px >= (frame.camera.width // 160) ** 2)
    boxes = {item.id: (gravity_aligned_box(true_mesh_world(truth, item).vertices, 0.01),) for item in truth.objects}
    found = depth_on_objects(saved, truth)
    in_boxes = depth_on_labels(saved, [TrueBox(id=i, kind="", counts=True, boxes=box) for i, box in boxes.items()])
    assert all(least[i] <= found[i] <= most[i] and least[i] <= in_boxes[i] for i in boxes)
    assert 0 < sum(found[i] >= 3 for i in boxes) < len(boxes)


def test_a_map_without_a_journal_does_not_know(short_map, demo_truth, tmp_path):
    shutil.copytree(short_map, tmp_path / "map", ignore=shutil.ignore_patterns("journal.mcap"))
    assert depth_on_objects(open_map(tmp_path / "map"), load_truth(demo_truth)) is None
