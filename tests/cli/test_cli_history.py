import re
import signal
from dataclasses import replace
import numpy as np
import psutil
from hickory_stream.changes.run_page import pictures_of
from hickory_stream.map_folder.saved_map import open_map
from tests.cli.test_cli import EAGER, Playing, answer, ended_as, look, refusal, said


def test_a_killed_run_resumes_to_the_map_of_an_undisturbed_one(short_log, coarse_config, tmp_path, short_map):
    log = tmp_path / "here.mcap"
    log.write_bytes(short_log.read_bytes())
    playing = Playing(log, coarse_config, tmp_path / "map", *EAGER)
    children = playing.wait_for_children()
    # Time stands still for it, else it might be over first.
    playing.me.suspend()
    assert f"is being written by process {playing.me.pid}" in refusal("resume", tmp_path / "map")
    playing.me.send_signal(signal.SIGKILL)
    playing.end()
    _, alive = psutil.wait_procs(children, timeout=5)
    assert alive == []
    looked = ended_as(0, "inspect", tmp_path / "map")
    assert f"continue with: hickory-stream resume {tmp_path / 'map'}" in looked.stderr
    assert "not finished: nothing was saved yet" in looked.stdout
    assert re.search(r"its journal holds [1-9]\d* keyframe", looked.stderr)
    # A log that was moved is missed, and can be named.
    moved = tmp_path / "elsewhere" / log.name
    moved.parent.mkdir()
    log.rename(moved)
    assert "here.mcap" in answer("resume", tmp_path / "map", status=2)["message"]
    resumed = answer("resume", tmp_path / "map", "--source", moved)
    assert resumed["finished_cleanly"] is True
    assert look("inspect", tmp_path / "map").stderr == ""
    assert {answer("inspect", path)["digest"] for path in (short_map, tmp_path / "map")} == {resumed["digest"]}


def test_replay_makes_the_map_and_a_recording_from_the_folder(short_map, tmp_path):
    assert answer("replay", short_map, "--rrd", tmp_path / "again.rrd")["is_same"] is True
    assert (tmp_path / "again.rrd").stat().st_size > 100_000


def test_inspect_and_render_show_the_map_of_a_moment(short_map, tmp_path):
    early, late = (answer("inspect", short_map, "--at", at) for at in ("1.0", "2.5"))
    assert len(early["objects"]) > 0
    assert early["digest"] != late["digest"]
    said("render", short_map, "--at", "1.0", "-o", tmp_path / "early.png", "--size", "480x240")
    assert (tmp_path / "early.png").stat().st_size > 1000
    assert "expected seconds from 0 to" in refusal("inspect", short_map, "--at", "tomorrow")


def test_diff_of_a_run_tells_and_writes_a_page_of_lost_objects(short_map, tmp_path):
    changes = answer("diff", short_map, "0", "2.5")["changes"]
    assert {change["kind"] for change in changes} >= {"appeared", "better view"}
    assert "appeared" in said("diff", short_map, "0", "2.5", "-o", tmp_path / "run.html")
    assert said("diff", short_map, "1", "1") == "nothing has changed\n"
    text = (tmp_path / "run.html").read_text()
    assert text.count('class="card"') == len(changes)
    assert "<svg" in text and "http" not in text
    best = next(item.best_view for item in open_map(short_map).snapshot.objects if item.best_view is not None)
    # A view whose pixels were removed is cut out of its keyframe's image.
    removed = replace(best, observation_index=999)
    found = pictures_of(short_map, [best, removed])
    assert set(found) == {best.name, removed.name}
    x0, y0, x1, y1 = best.box_px
    height, width = found[removed.name].shape[:2]
    assert x1 - x0 <= width <= x1 - x0 + 16
    assert y1 - y0 <= height <= y1 - y0 + 16
    rgb = found[best.name].reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(found[removed.name].reshape(-1, 3).mean(axis=0), rgb, atol=25)
    assert pictures_of(tmp_path, [best]) == {}


def test_diff_tells_what_is_in_one_of_two_maps_alone(short_map):
    found = answer("diff", short_map, "--other", short_map)
    assert found["both"]
    assert all(pair["a"] == pair["b"] and pair["iou"] > 0.999 for pair in found["both"])
    assert found["only_in_a"] == found["only_in_b"] == []
    first, *rest = said("diff", short_map, "--other", short_map).splitlines()
    assert first == f"{len(found['both'])} objects are in both (box overlap 0.5 and more)"
    assert rest == [f"0 only in {short_map}"] * 2
    for wrong in ((), ("1",), ("1", "2", "--other", short_map), ("1", "--other", short_map)):
        assert "expected either T1 and T2, or --other MAP" in refusal("diff", short_map, *wrong)
