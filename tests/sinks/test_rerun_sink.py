import re
import subprocess
import sys
from collections import Counter
from dataclasses import replace
import numpy as np
import pyarrow as pa
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from hickory_stream.errors import ViewerError
from hickory_stream.geometry.mesh import write_glb
from hickory_stream.geometry.rigid import apply, from_rotation_translation, yaw_rotation
from hickory_stream.mapping.entities.rigid_motion import moved_object
from hickory_stream.records import Decision, Phase
from hickory_stream.sinks.rerun.config import RerunConfig
from hickory_stream.sinks.rerun.meshes import placed_mesh
from hickory_stream.sinks.rerun.sink import RerunSink, ViewerChoice, ViewerKind
from tests.engine.snapshot_fixtures import box_mesh
from tests.sinks.report_fixtures import KEYFRAME_EVERY, PERIOD_NS, SHAPE_FRAME, START_NS, reports
from tests.strategies import quadric

NO_VIEWER = ViewerChoice(kind=ViewerKind.NONE)
NUM_FRAMES, MERGE_AT = 24, 16


def play(tmp_path, config=None, num_frames=NUM_FRAMES, width=160, change=None):
    path = tmp_path / "run.rrd"
    sink = RerunSink(config or RerunConfig(), tmp_path, path, NO_VIEWER)
    for report in reports(num_frames, tmp_path, width=width, merge_at=MERGE_AT):
        sink.show(report if change is None else change(report))
    sink.close()
    return path


def rows_of(path):
    """Return the rows of each entity as dicts of column name to value, without the static ones."""
    rows = {}
    for chunk in RrdReader(path).stream():
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            stamps = batch.column("log_time").cast(pa.int64())
            batch = batch.set_column(batch.schema.get_field_index("log_time"), "log_time", stamps)
            rows.setdefault(chunk.entity_path, []).extend(batch.to_pylist())
    # Rows with and without a keyframe lie in different chunks.
    return {path: sorted(found, key=lambda row: row["frame"]) for path, found in rows.items()}


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    return rows_of(play(tmp_path_factory.mktemp("rerun")))


def test_frames_have_camera_and_colour_and_keyframes_the_rest(rows):
    assert [row["frame"] for row in rows["/world/camera"]] == list(range(NUM_FRAMES))
    assert len(rows["/world/camera/color"]) == NUM_FRAMES
    num_keyframes = NUM_FRAMES // KEYFRAME_EVERY
    for name in ("depth", "masks", "boxes"):
        assert [row["keyframe"] for row in rows[f"/world/camera/{name}"]] == list(range(num_keyframes))


def test_the_three_timelines_hold_exact_stamps(rows):
    for row in rows["/world/camera"]:
        assert row["log_time"] == START_NS + row["frame"] * PERIOD_NS
    timelines = {name for chunk in rows.values() for row in chunk for name in row if ":" not in name}
    assert timelines - {"rerun.controls.RowId"} == {"log_time", "frame", "keyframe"}


def test_the_colour_is_the_bytes_of_the_log(tmp_path, rows):
    logged = bytes(rows["/world/camera/color"][3]["EncodedImage:blob"][0])
    assert logged == list(reports(4, tmp_path, width=160))[3].color_bytes


def test_every_object_has_its_four_layers(rows):
    for object_id in (1, 4, 7):
        assert f"/world/layer1/{object_id}/points" in rows
        assert f"/world/layer1/{object_id}/box" in rows
        for layer in (2, 3, 4):
            assert [row["frame"] for row in rows[f"/world/layer{layer}/{object_id}"]] == [SHAPE_FRAME]


def test_a_sketch_stands_for_layer_three_until_the_shape_comes(tmp_path):
    box = quadric((0.1, 0.1), (0.2, 0.2, 0.2))

    def change(report):
        if report.snapshot is None:
            return report
        objects = tuple(o if o.shape else replace(o, sketch=box) for o in report.snapshot.objects)
        return replace(report, snapshot=replace(report.snapshot, objects=objects))

    rows = rows_of(play(tmp_path, change=change))
    assert [row["frame"] for row in rows["/world/layer3/1"]] == [0, SHAPE_FRAME]
    assert [row["frame"] for row in rows["/world/layer4/1"]] == [SHAPE_FRAME]


def test_a_mesh_lies_on_the_box_that_it_was_made_of(tmp_path, rows):
    box = next(iter(reports(1, tmp_path, width=160))).snapshot.objects[0].box
    vertices = np.array(rows["/world/layer2/1"][0]["Mesh3D:vertex_positions"])
    np.testing.assert_allclose(vertices, box.corners_world(), atol=1e-5)


def test_a_cloud_is_logged_again_only_when_it_grew(tmp_path, rows):
    *_, last = (r for r in reports(NUM_FRAMES, tmp_path, width=160) if r.snapshot is not None)
    clouds = rows["/world/layer1/1/points"]
    # 24 frames at 15 Hz are 1.6 s: the first cloud, one a second later, one at the end.
    assert len(clouds) <= 3
    assert len(clouds[-1]["Points3D:positions"]) == len(last.snapshot.objects[0].points_world)


def test_a_large_cloud_is_thinned_to_its_limit(tmp_path):
    rows = rows_of(play(tmp_path, RerunConfig(max_points_per_object=50), num_frames=5))
    assert all(len(row["Points3D:positions"]) == 50 for row in rows["/world/layer1/1/points"])


def test_an_object_that_is_gone_is_cleared_in_all_layers(rows):
    for path in (*(f"layer{layer}" for layer in (1, 2, 3, 4)), "filled", "labels"):
        cleared = [row for row in rows[f"/world/{path}/2"] if row.get("Clear:is_recursive")]
        assert [row["frame"] for row in cleared] == [MERGE_AT]
    assert not any(row.get("Clear:is_recursive") for row in rows["/world/layer2/1"])


def test_a_moved_map_is_logged_again_with_layers_and_walls(tmp_path):
    move = from_rotation_translation(yaw_rotation(0.5), np.array([3.0, -1.0, 0.0]))
    first_moved = 2 * KEYFRAME_EVERY + SHAPE_FRAME // KEYFRAME_EVERY * KEYFRAME_EVERY

    def moved(report):
        if report.snapshot is None or report.index < first_moved:
            return report
        submaps = tuple(replace(s, world_from_submap=move @ s.world_from_submap) for s in report.snapshot.submaps)
        objects = tuple(moved_object(item, move) for item in report.snapshot.objects)
        return replace(report, snapshot=replace(report.snapshot, submaps=submaps, objects=objects))

    rows = rows_of(play(tmp_path, change=moved))
    still = rows_of(play(tmp_path))
    for path in ("layer1/1/points", "structure/floor"):
        there, here = (
            np.array(found[f"/world/{path}"][-1]["Points3D:positions"]).reshape(-1, 3) for found in (rows, still)
        )
        np.testing.assert_allclose(there, apply(move, here), atol=1e-5)
    for path in ("layer2/1", "layer3/1", "layer4/1", "structure/walls/0"):  # meshes stay, and their pose moves them
        *_, mesh = (row for row in rows[f"/world/{path}"] if "Mesh3D:vertex_positions" in row)
        (pose,) = (row for row in rows[f"/world/{path}"] if "Transform3D:mat3x3" in row)
        assert (mesh["Mesh3D:vertex_positions"], pose["frame"]) == (
            still[f"/world/{path}"][-1]["Mesh3D:vertex_positions"], first_moved,
        )  # fmt: skip
        np.testing.assert_allclose(np.reshape(pose["Transform3D:mat3x3"], (3, 3)).T, move[:3, :3], atol=1e-6)
        np.testing.assert_allclose(np.ravel(pose["Transform3D:translation"]), move[:3, 3], atol=1e-6)


def test_every_object_has_a_thumbnail_of_its_best_view(tmp_path, rows):
    *_, last = (r for r in reports(NUM_FRAMES, tmp_path, width=160, merge_at=MERGE_AT) if r.snapshot is not None)
    for seen in last.snapshot.objects:
        assert rows[f"/views/{seen.id}/image"][-1]["frame"] == seen.best_view.frame_index


def test_a_replay_has_the_same_best_views_from_compressed_colour(tmp_path, rows):
    again = rows_of(play(tmp_path, change=lambda report: replace(report, frame=None)))
    for path in (path for path in rows if path.startswith("/views/") and path.endswith("/image")):
        assert [row["frame"] for row in again[path]] == [row["frame"] for row in rows[path]]


def test_at_the_end_the_thumbnails_are_in_id_order(rows):
    places = {}
    for path, found in rows.items():
        if re.fullmatch(r"/views/\d+", path) and not found[-1].get("Clear:is_recursive"):
            x, y, _ = found[-1]["Transform3D:translation"][0]
            places[int(path.rpartition("/")[2])] = (y, x)
    assert sorted(places) == [1, 3, 4, 5, 6, 7]
    assert sorted(places, key=places.__getitem__) == sorted(places)
    steps = np.diff([x for _, x in sorted(places.values())])
    assert (steps == steps[0]).all()


def test_a_caption_of_a_view_changes_with_the_phase(tmp_path):
    def ended(report):
        if report.snapshot is None or report.index < NUM_FRAMES - KEYFRAME_EVERY:
            return report
        objects = tuple(replace(o, phase=Phase.ARCHIVED) for o in report.snapshot.objects)
        return replace(report, snapshot=replace(report.snapshot, objects=objects))

    before, after = (rows_of(play(tmp_path, change=change))["/views/1/caption"] for change in (None, ended))
    assert len(after) == len(before) + 1
    assert after[-1]["frame"] == NUM_FRAMES - KEYFRAME_EVERY


def test_generated_surface_of_a_mesh_is_tinted(tmp_path):
    box = box_mesh((1.0, 1.0, 1.0), (200, 200, 200))
    mesh = replace(box, is_seen=np.arange(len(box.vertices)) > 3)
    write_glb(mesh, tmp_path / "a.glb")
    colors = np.array(placed_mesh(tmp_path / "a.glb", np.eye(4)).vertex_colors.as_arrow_array().to_pylist())
    red, green = colors >> 24, colors >> 16 & 255
    assert (red[:4] > green[:4] + 30).all()
    assert (colors[4:] == 0xC8C8C8FF).all()


def test_decisions_are_lines_under_their_kind_and_their_object(tmp_path, rows):
    decided = [d for r in reports(NUM_FRAMES, tmp_path, width=160) for d in r.decisions]
    expected = Counter(d.kind for d in decided)
    assert {kind: len(rows[f"/decisions/{kind}"]) for kind in expected} == expected
    assert rows["/decisions/reject"][0]["TextLog:text"][0].startswith("reject: mask (3, 5, 9, 12)")
    expected = Counter(d.object_id for d in decided if d.object_id is not None)
    assert {i: len(rows[f"/decisions_of/{i}"]) for i in expected} == expected
    assert all(row["TextLog:text"][0].startswith("#4 associate: ") for row in rows["/decisions_of/4"])


def test_what_is_routine_is_no_warning_and_a_jump_is_one(tmp_path):
    told = (
        Decision(kind="drop", object_id=4, text="never confirmed, after 2 sightings"),
        Decision(kind="pose_jump", object_id=None, text="the odometry jumped by 3.20 m: submap 1 begins"),
        Decision(kind="reject", object_id=None, text="mask (3, 5, 9, 12): 21 pixels, 60 needed"),
        Decision(kind="phase", object_id=5, text="tentative -> active after 4 sightings"),
        Decision(kind="phase", object_id=6, text="active -> dormant after 9 sightings"),
        Decision(kind="view", object_id=7, text="frame 3: bound 3.040 <= best 3.205"),
    )
    rows = rows_of(play(tmp_path, num_frames=1, change=lambda report: replace(report, decisions=told)))
    kinds = ("drop", "pose_jump", "reject", "phase", "view")
    levels = {row["TextLog:text"][0]: row["TextLog:level"][0] for kind in kinds for row in rows[f"/decisions/{kind}"]}
    assert [levels[text] for text in sorted(levels)] == ["INFO", "INFO", "DEBUG", "DEBUG", "WARN", "DEBUG"]


def test_a_list_of_candidates_is_complete_in_rows_that_fit(tmp_path):
    candidates = ", ".join(f"#{i} 0.{i:02d}" for i in range(99, 10, -1))
    told = (Decision(kind="create", object_id=7, text=f"mask (1, 2, 3, 4): new; candidates by IoU: {candidates}"),)
    rows = rows_of(play(tmp_path, num_frames=1, change=lambda report: replace(report, decisions=told)))
    for path in ("/decisions/create", "/decisions_of/7"):
        lines = [row["TextLog:text"][0] for row in rows[path]]
        assert max(map(len, lines)) <= 160
        assert " ".join(line.strip() for line in lines).endswith(candidates)


def test_the_last_report_leaves_the_last_masks_in_view(tmp_path):
    """Only the map of it is new: no image, no masks."""

    def change(report):
        if report.index < KEYFRAME_EVERY:
            return report
        return replace(report, frame=None, color_bytes=None, observations=(), object_ids=())

    rows = rows_of(play(tmp_path, num_frames=KEYFRAME_EVERY + 1, change=change))
    for name in ("masks", "boxes", "labels", "rejected/masks"):
        assert [row["keyframe"] for row in rows[f"/world/camera/{name}"]] == [0]
    assert len(rows["/world/camera"]) == KEYFRAME_EVERY + 1


def test_boxes_are_lines_and_their_fillings_entities_apart(rows):
    for object_id in (1, 4, 7):
        lines, filled = rows[f"/world/layer1/{object_id}/box"], rows[f"/world/filled/{object_id}"]
        assert {row["Boxes3D:fill_mode"][0] for row in lines} == {rr.components.FillMode.MajorWireframe.value}
        assert {row["Boxes3D:fill_mode"][0] for row in filled} == {
            rr.components.FillMode.TransparentFillMajorWireframe.value
        }
        assert [row["Boxes3D:half_sizes"] for row in lines] == [row["Boxes3D:half_sizes"] for row in filled]


def test_a_mask_is_numbered_once_per_object_in_its_largest_part(tmp_path, rows):
    first = next(iter(reports(1, tmp_path, width=160)))
    row = rows["/world/camera/labels"][0]
    assert row["Points2D:labels"] == [str(i) for i in sorted(set(first.object_ids))]
    assert len(row["Points2D:positions"]) == len(row["Points2D:labels"])


def test_every_metric_and_the_objects_per_phase_are_plotted(tmp_path, rows):
    for name, value in next(iter(reports(1, tmp_path, width=160))).metrics:
        assert rows[f"/plots/{name}"][0]["Scalars:scalars"] == [pytest.approx(value)]
    assert rows["/plots/objects/tentative"][0]["Scalars:scalars"] == [1.0]


def test_the_trajectory_grows_linearly_and_keeps_every_place(tmp_path):
    rows = rows_of(play(tmp_path, num_frames=200, width=32))
    pieces = {path: r for path, r in rows.items() if path.startswith("/world/trajectory/")}
    assert len(pieces) == 4
    # The pieces overlap by one point, so that the line has no gaps.
    assert sum(len(r[-1]["LineStrips3D:strips"][0]) for r in pieces.values()) == 200 + 3
    assert max(len(row["LineStrips3D:strips"][0]) for r in pieces.values() for row in r) == 64


def test_a_file_at_its_cap_gets_light_data_only(tmp_path, caplog):
    rows = rows_of(play(tmp_path, RerunConfig(rrd_cap_mb=0.001), num_frames=40))
    assert len(rows["/world/camera"]) == 40
    assert len(rows["/plots/time/segment"]) == 40 // KEYFRAME_EVERY
    assert len(rows.get("/world/camera/color", [])) < 40
    assert [r.levelname for r in caplog.records if "cap" in r.message] == ["WARNING"]


def test_from_half_of_its_cap_on_a_file_has_images_of_keyframes(tmp_path, monkeypatch):
    monkeypatch.setattr("hickory_stream.sinks.rerun.file.RrdFile._num_bytes", lambda _: 600_000_000)
    rows = rows_of(play(tmp_path, num_frames=9))
    assert [row["frame"] for row in rows["/world/camera/color"]] == [0, 4, 8]
    assert len(rows["/world/camera"]) == 9


@pytest.mark.parametrize(("config", "change", "frames"), [
    (RerunConfig(color_every=3), {}, [0, 3, 4, 6, 8]),
    (RerunConfig(), {"change": lambda report: replace(report, color_bytes=None)}, [0, 4, 8]),
], ids=["every third one", "encoded here"])  # fmt: skip
def test_colour_of_every_nth_frame_and_of_keyframes_is_kept(tmp_path, config, change, frames):
    rows = rows_of(play(tmp_path, config, num_frames=9, **change))
    assert [row["frame"] for row in rows["/world/camera/color"]] == frames


def test_a_missing_mesh_is_a_warning_and_other_layers_show(tmp_path, caplog):
    def lose_mesh(report):
        (tmp_path / "shapes" / "3.glb").unlink(missing_ok=True)
        return report

    rows = rows_of(play(tmp_path, num_frames=SHAPE_FRAME + 1, change=lose_mesh))
    assert "/world/layer2/3" not in rows
    assert "/world/layer3/3" in rows
    assert "3.glb" in caplog.text


def test_a_frame_that_sees_nothing_can_be_shown(tmp_path):
    def blind(report):
        nothing = replace(report.frame, depth_m=np.full_like(report.frame.depth_m, np.nan))
        return replace(report, frame=nothing, observations=(), object_ids=(), snapshot=None, decisions=())

    rows = rows_of(play(tmp_path, num_frames=1, change=blind))
    assert len(rows["/world/camera/masks"]) == 1


def test_a_sink_without_file_and_viewer_does_nothing(tmp_path):
    sink = RerunSink(RerunConfig(), tmp_path, None, NO_VIEWER)
    for report in reports(2, tmp_path / "map"):
        sink.show(report)
    sink.close()
    assert [p.name for p in tmp_path.iterdir()] == ["map"]


def test_an_unwritable_file_is_refused_before_anything_runs(tmp_path):
    with pytest.raises(ViewerError, match="missing"):
        RerunSink(RerunConfig(), tmp_path, tmp_path / "missing" / "run.rrd", NO_VIEWER)


def test_importing_the_sink_does_not_import_rerun():
    code = "import sys, hickory_stream.sinks.rerun.sink; print('rerun' in sys.modules, 'cv2' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]


def test_the_time_of_one_stream_is_not_left_behind_for_another(tmp_path):
    play(tmp_path, num_frames=1)
    other = rr.RecordingStream("other", recording_id="other", send_properties=False)
    other.save(tmp_path / "other.rrd")
    other.log("a", rr.Scalars(1.0))
    other.disconnect()
    timelines = {name for chunk in RrdReader(tmp_path / "other.rrd").stream() for name in chunk.timeline_names}
    assert "frame" not in timelines


def test_what_was_merged_says_under_its_own_name_what_it_became(tmp_path):
    told = (Decision(kind="merge", object_id=7, text="#9 is the same: seen as one", other_id=9),)
    rows = rows_of(play(tmp_path, num_frames=1, change=lambda report: replace(report, decisions=told)))
    for path in ("/decisions_of/7", "/decisions_of/9"):
        assert [row["TextLog:text"][0] for row in rows[path]] == ["#7 merge: #9 is the same: seen as one"]


def test_the_state_of_robot_topics_shows_in_a_live_run_only(tmp_path):
    told = iter(f"zenoh://robot: connected, {i}" for i in range(100))
    path = tmp_path / "live.rrd"
    sink = RerunSink(RerunConfig(), tmp_path, path, NO_VIEWER, lambda: next(told))
    for report in reports(3, tmp_path, width=160):
        sink.show(report)
    sink.close()
    found = [row["TextDocument:text"][0] for row in rows_of(path)["/robot"]]
    assert found[0] == "```\nzenoh://robot: connected, 0\n```"
    assert "/robot" not in rows_of(play(tmp_path, num_frames=3))


def test_a_selected_shape_says_who_made_it(rows):
    shapes = [row for path, found in rows.items() if path.startswith("/world/layer3/") for row in found]
    facts = [row for row in shapes if "hickory_stream.Shape:layer_3_of" in row]
    assert facts
    for row in facts:
        assert row["hickory_stream.Shape:layer_3_of"] == ["solid"]
        assert row["hickory_stream.Shape:verdict"] == ["none was asked for"]
