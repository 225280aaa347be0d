import html
import json
import shutil
from dataclasses import asdict
import numpy as np
import pytest
from hickory_stream.evaluation.evaluate import evaluate
from hickory_stream.evaluation.false_origins import FALSE_ORIGINS
from hickory_stream.evaluation.match import surface_of
from hickory_stream.evaluation.miss_reasons import MISS_REASONS
from hickory_stream.evaluation.page import write_page
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.evaluation.why import investigate, reasons_of
from hickory_stream.evaluation.why_text import why_text
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.map_folder.history.recorded import frame_indices, recorded_steps
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.records import kind_text
from tests.cli.test_cli import answer, ended_as, refusal, said


@pytest.fixture(scope="module")
def found(short_map, demo_truth):
    return evaluate(open_map(short_map), load_truth(demo_truth))


def test_the_history_of_a_map_spares_a_second_read(short_map, demo_truth, found, monkeypatch):
    saved, truth = open_map(short_map), load_truth(demo_truth)
    history = investigate(saved, truth)
    monkeypatch.delattr("hickory_stream.evaluation.reach.recorded_steps")
    assert evaluate(saved, truth, history.score) == found
    assert found.num_reachable


@pytest.fixture(scope="module")
def why(short_map, demo_truth):
    return reasons_of(open_map(short_map), load_truth(demo_truth))


def keyframes(path):
    return [step for step in recorded_steps(path, open_map(path).snapshot) if step.keyframe is not None]


def middle_of(observation):
    """The pixel of a mask that is nearest to its middle."""
    rows, columns = np.nonzero(observation.mask)
    middle = np.argmin(np.hypot(rows - rows.mean(), columns - columns.mean()))
    return int(observation.box_px[0] + columns[middle]), int(observation.box_px[1] + rows[middle])


def test_a_point_of_an_object_is_in_it_and_its_masks_went_there(short_map):
    tracked = max(open_map(short_map).snapshot.objects, key=lambda o: o.sightings)
    middle = tracked.points_world[np.argmin(np.linalg.norm(tracked.points_world - tracked.box.center, axis=1))]
    told = answer("explain", short_map, f"--point={','.join(f'{value:.4f}' for value in middle)}")
    assert told["objects"][0]["id"] == tracked.id
    assert told["verdict"].startswith(f"in #{tracked.id}, {kind_text(tracked.fixture_probability)}; of ")
    masks = [sighting for sighting in told["sightings"] if sighting["where"] == "mask"]
    assert len(masks) >= tracked.sightings // 2
    assert tracked.id in {sighting["track_id"] for sighting in masks}
    story = next(track for track in told["tracks"] if track["id"] == tracked.id)
    assert (story["ending"], story["map_id"]) == ("", tracked.id)
    assert told["num_keyframes"] == len(keyframes(short_map))


def test_a_place_behind_every_camera_is_in_no_image(short_map):
    text = said("explain", short_map, "--point=0,0,500")
    assert text == "at (0.00, 0.00, 500.00) m: in no object; no keyframe has it in its image\n"


def test_a_floor_place_was_structure_and_an_air_place_free(short_map):
    step = keyframes(short_map)[0]
    coarse = step.keyframe.observed.coarse
    rows, columns = np.nonzero(coarse.structure & (coarse.depth_mm > 0))
    middle = len(rows) // 2
    pixel = (columns[middle] + 0.5) * coarse.stride_px, (rows[middle] + 0.5) * coarse.stride_px
    frame = step.keyframe.observed.frame_index
    told = answer("explain", short_map, "--at-pixel", f"{frame},{pixel[0]:.0f},{pixel[1]:.0f}")
    assert told["asked"]["text"] == "taken for structure"
    own = next(sighting for sighting in told["sightings"] if sighting["frame"] == frame)
    assert own["where"] == "structure"
    between = (step.keyframe.observed.world_from_camera[:3, 3] + np.array(told["point_m"])) / 2
    told = answer("explain", short_map, f"--point={','.join(map(str, between))}")
    assert next(s for s in told["sightings"] if s["frame"] == frame)["where"] == "looked through"
    assert told["verdict"].startswith("in no object; of ")


def test_a_pixel_of_a_mask_leads_to_the_track_of_the_mask(short_map):
    step = keyframes(short_map)[-1]
    observed = step.keyframe.observed
    for observation in observed.observations[:2]:
        u, v = middle_of(observation)
        told = answer("explain", short_map, "--at-pixel", f"{observed.frame_index},{u},{v}")
        track_id = next(d.object_id for d in step.decisions if d.observation_index == observation.index)
        assert told["asked"]["text"] == f"in a mask that went to #{track_id}"
        own = next(sighting for sighting in told["sightings"] if sighting["frame"] == observed.frame_index)
        assert own["where"] == "mask"
        assert np.hypot(own["pixel"][0] - u, own["pixel"][1] - v) < 8


def test_a_pixel_of_another_frame_is_found_with_the_log(short_map, short_log):
    of_keyframes, frames = frame_indices(short_map)
    frame = int(next(i for i in frames if i not in of_keyframes))
    told = refusal("explain", short_map, "--at-pixel", f"{frame},320,180")
    assert f"frame {frame} of {short_map} is no keyframe" in told
    assert "or give --log LOG" in told
    # The camera moves little between two frames: what the keyframe before has in a mask's middle is there, too.
    step = [s for s in keyframes(short_map) if s.keyframe is not None and s.keyframe.observed.frame_index < frame][-1]
    largest = max(step.keyframe.observed.observations, key=lambda o: int(o.mask.sum()))
    u, v = middle_of(largest)
    found = answer("explain", short_map, "--at-pixel", f"{frame},{u},{v}", "--log", short_log)
    assert found["asked"]["text"] == "the frame is no keyframe: the place is from the log's depth"
    own = found["sightings"][0]
    assert own["where"] == "mask"
    x0, y0, x1, y1 = step.keyframe.observed.observations[own["observation_index"]].box_px
    assert x0 <= own["pixel"][0] <= x1
    assert y0 <= own["pixel"][1] <= y1


@pytest.mark.parametrize(("arguments", "told"), [
    (["--point", "1,2"], "found --point 1,2, expected X,Y,Z in metres"),
    (["--point", "1,2,nan"], "expected three finite numbers"),
    (["--at-pixel", "0.5,1,1"], "expected FRAME,U,V"),
    (["--at-pixel", "900,1,1"], "found frame 900, expected one of the 18 frames"),
    (["--at-pixel", "0,9999,1"], "found the pixel 9999,1, expected a column of 0 to"),
    (["--point", "1,2,3", "--object", "1"], "without --truth DIR"),
    (["--point", "1,2,3", "--log", "x.mcap"], "found --log without --at-pixel"),
    (["--truth", "nowhere"], "nowhere is no truth folder"),
])  # fmt: skip
def test_what_cannot_be_asked_is_refused_in_a_line(short_map, arguments, told):
    assert told in refusal("explain", short_map, *arguments)


def test_a_map_without_a_journal_says_so(short_map, tmp_path):
    copy = tmp_path / "map"
    shutil.copytree(short_map, copy, ignore=shutil.ignore_patterns("journal.mcap"))
    assert "the map keeps no history; play the log again" in refusal("explain", copy, "--point", "0,0,0")


def test_every_missed_object_and_every_false_one_is_explained(short_map, found, why):
    assert {missed.truth_id for missed in why.missed} == {row.truth_id for row in found.objects if row.map_id is None}
    assert (why.num_truth, why.num_reachable) == (found.num_truth, found.num_reachable)
    beyond = {row.truth_id for row in found.objects if not row.is_reachable and row.map_id is None}
    assert {missed.truth_id for missed in why.missed if missed.reason == "out of reach"} == beyond
    assert len(why.missed) > 3
    matched = {row.map_id for row in found.objects}
    objects = {o.id for o in open_map(short_map).snapshot.objects if o.phase != "tentative"}
    assert {false.map_id for false in why.false} == objects - matched - set(found.ignored_ids)
    assert {missed.reason for missed in why.missed} <= set(MISS_REASONS)
    assert {false.origin for false in why.false} <= set(FALSE_ORIGINS)
    assert sum(item.count for item in why.reasons) == len(why.missed)


def test_the_command_prints_what_was_found_as_json_and_as_text(short_map, demo_truth, why):
    told = answer("explain", short_map, "--truth", demo_truth)
    assert {key: told[key] for key in told.keys() - {"output", "version"}} == json.loads(json.dumps(asdict(why)))
    text = why_text(why)
    assert f"{len(why.missed)} of {why.num_truth} true objects that count are missed" in text
    assert all(f"of {len(why.missed)}  {item.reason}" in text for item in why.reasons)
    assert all(f"{missed.kind}: {missed.reason}" in text for missed in why.missed)


def test_an_unseen_object_is_missed_for_that_reason(short_map, demo_truth, found, why):
    unseen = next(missed for missed in why.missed if missed.best_frame is None)
    story = answer("explain", short_map, "--truth", demo_truth, "--object", unseen.truth_id)
    assert (story["sightings"], story["missed"]["reason"]) == ([], "out of reach")
    assert story["missed"]["text"] == f"none of {why.num_keyframes} keyframes shows it"
    good = max(found.objects, key=lambda row: row.iou)
    told = said("explain", short_map, "--truth", demo_truth, "--object", good.truth_id)
    assert f"found: it is #{good.map_id}, box IoU {good.iou:.2f}" in told
    assert f"in a mask of its own, which went to #{good.map_id}" in told
    assert "expected the id of a true object" in refusal("explain", short_map, "--truth", demo_truth, "--object", 999)


def test_the_page_of_an_evaluation_explains_every_error(short_map, demo_truth, tmp_path, found, why):
    write_page(tmp_path / "page.html", open_map(short_map), load_truth(demo_truth), found)
    page = html.unescape((tmp_path / "page.html").read_text())
    assert f"<h3>{len(why.missed)} of {why.num_truth} true objects that count are missed" in page
    for item in why.reasons:
        assert f"<td class=n>{item.count} of {len(why.missed)}</td>" in page
        assert f"<td>{item.reason}</td>" in page
    for missed in why.missed:
        assert f"<span>missed: {missed.reason}</span>" in page
        assert f"<p class=why>{missed.text}</p>" in page
        assert missed.best_frame is None or f"<figcaption>frame {missed.best_frame}</figcaption>" in page
    for false in why.false:
        assert f"<b>object #{false.map_id}</b><span>{false.origin}</span>" in page
        assert f"<p class=why>{false.text}</p>" in page


def copied(path, to, **changes):
    """A copy of a map with changes of its manifest."""
    shutil.copytree(path, to)
    manifest = json.loads((to / "manifest.json").read_text())
    (to / "manifest.json").write_text(json.dumps({**manifest, **changes}))
    return to


def test_a_configuration_of_another_version_is_no_hindrance(short_map, tmp_path):
    config = json.loads((short_map / "manifest.json").read_text())["config"]
    config["mapping"]["lifecycle"]["colour_of_the_moon"] = 3
    point = "--point=0.5,0.5,0.5"
    changed = copied(short_map, tmp_path / "map", config=config)
    assert answer("explain", changed, point) == answer("explain", short_map, point)


def test_a_run_that_was_killed_is_explained_as_far_as_it_came(short_map, demo_truth, tmp_path, why):
    killed = copied(short_map, tmp_path / "map", finished_cleanly=False, digest=None)
    (killed / "objects.json").unlink()
    with Journal(short_map) as journal:
        writer = JournalWriter(killed, flush_s=0.0)
        num_keyframes = 5
        for i in range(num_keyframes):
            writer.append(journal.entry(i))
        writer.abandon()
    told = answer("explain", killed, "--truth", demo_truth)
    assert told["num_keyframes"] == num_keyframes
    assert len(told["missed"]) >= len(why.missed)


def test_labels_by_hand_score_a_map_as_its_whole_truth_does(found, short_map, demo_truth, tmp_path):
    labels = []
    for item in (truth := load_truth(demo_truth)).objects:
        box = gravity_aligned_box(surface_of(truth, item).vertices, 0.005)
        yaw = np.arctan2(box.world_from_box[1, 0], box.world_from_box[0, 0])
        size = {"center": box.center.tolist(), "size": (2 * box.half_extents_m).tolist(), "yaw": float(yaw)}
        labels.append({"id": item.id, "name": item.kind, "ignore": item.seen_fraction < 0.3, **size})
    content = {"format": 1, "upright_from_world": np.eye(3).tolist(), "objects": labels}
    (tmp_path / "boxes.json").write_text(json.dumps(content))
    told = answer("evaluate", short_map, "--truth", tmp_path)
    for name in ("num_truth", "num_objects", "recall_25", "recall_50"):
        assert told[name] == pytest.approx(getattr(found, name)), name
    assert not {"f1_5pct", "containment", "poses"} & told.keys()
    refused = refusal("evaluate", short_map, "--truth", tmp_path, "--html", tmp_path / "a.html")
    assert "boxes have no surfaces" in refused


def test_labels_of_another_world_are_noticed(short_map, tmp_path):
    far = {"id": 1, "center": [90, 0, 0], "size": [1, 1, 1], "yaw": 0}
    content = {"format": 1, "upright_from_world": np.eye(3).tolist(), "objects": [far]}
    (tmp_path / "far.json").write_text(json.dumps(content))
    ended = ended_as(0, "evaluate", short_map, "--truth", tmp_path / "far.json")
    assert "labels must be in the world of the poses" in ended.stderr
    assert "recall 0.25 / 0.5       0.000 / 0.000" in ended.stdout
