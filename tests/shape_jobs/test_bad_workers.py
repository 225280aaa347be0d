import json
import pytest
from hickory_stream.base.caches import cache_folder
from hickory_stream.box_scene import SCENE_BOXES
from hickory_stream.cli import main
from hickory_stream.errors import ConfigError
from hickory_stream.map_folder.saved_map import open_map
from tests.engine.run_fixtures import map_scene, shape_workers
from tests.shape_jobs.bad_worker import write_interpreter

ONCE = ("mapping.requests.max_failures=1", "mapping.requests.first_sightings=99")


@pytest.mark.parametrize(
    ("way", "reasons", "is_reproducible"),
    [
        ("empty+nan+raises", ("an empty mesh", "not finite", "out of ideas"), True),
        ("segfaults", ("SIGSEGV",), False),
        ("hangs", ("no answer within 1 s",), False),
        ("grows", ("more than 300 MB of memory",), False),
    ],
)
def test_a_failing_job_says_why_and_leaves_the_rest_of_the_map(tmp_path, way, reasons, is_reproducible):
    python = write_interpreter(tmp_path / "python", way)
    limits = ("run.job_timeout_s=1.0",) if way == "hangs" else ("run.job_memory_mb=300.0",) if way == "grows" else ()
    # A worker that has to be replaced takes seconds: one object then, which is tried twice.
    boxes = SCENE_BOXES if is_reproducible else SCENE_BOXES[:1]
    run = map_scene(tmp_path, *ONCE, *limits, f"run.worker_python={python}", boxes=boxes, child_workers=True)
    saved = open_map(run.folder.path)
    assert saved.manifest.finished_cleanly
    assert saved.manifest.is_reproducible == is_reproducible
    assert [tracked.shape for tracked in saved.snapshot.objects] == [None] * len(boxes)
    assert all(len(tracked.points_world) for tracked in saved.snapshot.objects)
    assert saved.ledger["shapes"]["failed"] == len(boxes)
    assert all(reason in _reasons(run.folder.path) for reason in reasons)
    # The input is kept, and can be tried by hand with the reconstructor that works.
    kept = sorted((run.folder.path / "failed").iterdir())
    assert [folder.name for folder in kept] == ["000001", "000002", "000003"][: len(boxes)]
    if is_reproducible:
        assert main(["reconstruct", str(kept[0])]) == 0
        assert (kept[0] / "mesh.glb").is_file()
    assert shape_workers() == []


def _reasons(path):
    from hickory_stream.journal.reader import Journal

    with Journal(path) as journal:
        return " ".join(str(event) for i in range(len(journal)) for event in journal.events(i, "ShapeFailed"))


def test_a_reconstructor_may_print_what_it_likes(tmp_path):
    python = write_interpreter(tmp_path / "python", "prints")
    run = map_scene(tmp_path, *ONCE, f"run.worker_python={python}", child_workers=True)
    assert all(tracked.shape is not None for tracked in open_map(run.folder.path).snapshot.objects)


def test_a_missing_interpreter_is_refused_before_playing(tmp_path):
    with pytest.raises(ConfigError, match="worker_python is /no/such/python, which is no program"):
        map_scene(tmp_path, "run.worker_python=/no/such/python", child_workers=True)
    assert not (tmp_path / "map").exists()


def test_an_interpreter_that_cannot_work_fails_jobs_and_says_why(tmp_path):
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\nexit 3\n")
    broken.chmod(0o755)
    run = map_scene(tmp_path, *ONCE, f"run.worker_python={broken}", child_workers=True)
    assert "ended with status 3" in _reasons(run.folder.path)
    assert open_map(run.folder.path).manifest.finished_cleanly


@pytest.mark.parametrize("content", [None, "not json", '{"views": []}'])
def test_what_is_no_job_cannot_be_repeated(tmp_path, capsys, content):
    if content is not None:
        (tmp_path / "job.json").write_text(content)
    assert main(["reconstruct", str(tmp_path), "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["event"] == "error"


def test_a_second_playback_takes_its_shapes_from_the_cache(tmp_path, monkeypatch):
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "kernels").symlink_to(cache_folder("kernels"))  # what is compiled stays compiled
    monkeypatch.setenv("HICKORY_CACHE", str(tmp_path / "cache"))
    first = map_scene(tmp_path, "run.shape_cache=true", name="first")
    python = write_interpreter(tmp_path / "python", "raises")
    second = map_scene(
        tmp_path, "run.shape_cache=true", f"run.worker_python={python}", name="second", child_workers=True
    )
    shapes = open_map(second.folder.path).ledger["shapes"]
    assert shapes["cached"] == shapes["requested"] == shapes["ready"] >= 3
    assert second.digest == first.digest
    changed = map_scene(
        tmp_path, "run.shape_cache=true", "shapes.inflate.r_safe_m=0.03", f"run.worker_python={python}", name="third",
        child_workers=True,
    )  # fmt: skip
    assert "cached" not in open_map(changed.folder.path).ledger["shapes"]
