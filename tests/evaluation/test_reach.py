import shutil
import numpy as np
from hickory_stream.evaluation.match import TrueBox
from hickory_stream.evaluation.reach import depth_on_labels, depth_on_objects
from hickory_stream.evaluation.truth import frame_at, instances_of, load_truth, mesh_of, moved_mesh
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.map_folder.history.recorded import recorded_steps
from hickory_stream.map_folder.saved_map import open_map
from players import open_source


def test_keyframes_count_where_the_log_has_depth_on_a_thing(short_map, short_log, demo_truth):
    saved, truth = open_map(short_map), load_truth(demo_truth)
    found = depth_on_objects(saved, truth)
    keyframes = {step.keyframe.observed.stamp_ns for step in recorded_steps(short_map, saved.snapshot) if step.keyframe}
    stamps = np.array([frame.stamp_ns for frame in truth.frames])
    most, least = dict.fromkeys(range(1000), 0), dict.fromkeys(range(1000), 0)
    for frame in (one.decode() for one in open_source(str(short_log)).frames()):
        if frame.stamp_ns not in keyframes:
            continue
        shown = instances_of(truth, truth.frames[frame_at(stamps, frame.stamp_ns)])
        cell_px = (frame.camera.width // 160) ** 2
        for i, px in zip(*np.unique(shown[frame.depth_m > 0], return_counts=True), strict=True):
            most[int(i)] += px >= 1 * cell_px
            least[int(i)] += px >= 12 * cell_px
    ids = {item.id for item in truth.objects}
    assert all(least[i] <= found[i] <= most[i] for i in ids)
    assert 0 < sum(found[i] >= 3 for i in ids) < len(ids)
    boxes = {item.id: moved_mesh(mesh_of(truth, item), item.world_from_object) for item in truth.objects}
    labels = [
        TrueBox(id=i, kind="", counts=True, boxes=(gravity_aligned_box(mesh.vertices, 0.01),))
        for i, mesh in boxes.items()
    ]
    in_boxes = depth_on_labels(saved, labels)
    assert all(in_boxes[i] >= least[i] for i in ids)


def test_a_map_without_a_journal_does_not_know(short_map, demo_truth, tmp_path):
    shutil.copytree(short_map, tmp_path / "map", ignore=shutil.ignore_patterns("journal.mcap"))
    assert depth_on_objects(open_map(tmp_path / "map"), load_truth(demo_truth)) is None
