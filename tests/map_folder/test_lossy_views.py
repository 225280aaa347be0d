import shutil
from dataclasses import replace
import numpy as np
from hickory_stream.box_scene import SceneSource
from hickory_stream.config import RunConfig
from hickory_stream.engine.shape_jobs.job_folder import read_job, write_job
from hickory_stream.engine.shape_jobs.processor import processor_kind
from hickory_stream.map_folder.codec import encode_superquadrics
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.views import crop_files, read_crop
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.shapes.build import build_shape, make_reconstructor
from tests.cli.test_cli import refusal, said
from tests.engine.run_fixtures import (
    NO_SHAPES,
    NUM_FRAMES,
    map_scene,
    resume_scene,
    scene_config,
    scene_request,
    stop_at,
)
from tests.engine.snapshot_fixtures import make_snapshot

JPEG = "run.view_colors=jpeg"


def test_a_run_with_lossy_views_goes_on_to_the_same_map(tmp_path):
    exact = map_scene(tmp_path, *NO_SHAPES, name="exact")
    stopped = map_scene(tmp_path, *NO_SHAPES, JPEG, on_progress=stop_at(4)).folder.path
    assert not open_map(stopped).manifest.finished_cleanly

    assert resume_scene(stopped, SceneSource(NUM_FRAMES)) == exact.digest, (
        "layer 1 and the choice of views have nothing of the files"
    )
    lossy, views = open_map(stopped), exact.folder.views
    names = [view.name for tracked in lossy.snapshot.objects for view in tracked.views]
    assert len(names) >= 3
    for name in names:
        one, other = read_crop(lossy.views, name), read_crop(views, name)
        assert np.array_equal(one.mask, other.mask)
        assert np.array_equal(one.depth_m, other.depth_m, equal_nan=True)
        assert not np.array_equal(one.rgb, other.rgb)


def test_a_shape_of_lossy_views_differs_in_colours_only(tmp_path):
    config, built = scene_config(tmp_path / "config").shapes, []
    for colors in ("png", "jpeg"):
        views, folder = tmp_path / colors, tmp_path / "jobs" / colors
        views.mkdir()
        write_job(folder, scene_request(views, num_views=2, views_as=RunConfig(view_colors=colors)), views, config)
        shutil.rmtree(views)  # what a job needs is its own
        inputs, read = read_job(folder)
        built.append(build_shape(inputs, make_reconstructor(read.reconstructor, read), read))
    exact, lossy = built
    mesh, exact_mesh = lossy.reconstruction.mesh, exact.reconstruction.mesh
    assert np.array_equal(mesh.vertices, exact_mesh.vertices)
    assert np.array_equal(mesh.faces, exact_mesh.faces)
    assert np.array_equal(mesh.is_seen, exact_mesh.is_seen)
    assert 0 < np.abs(mesh.colors.astype(int) - exact_mesh.colors).mean() < 5
    assert encode_superquadrics(lossy.inflated) == encode_superquadrics(exact.inflated)


def test_a_map_with_lossy_views_names_its_codecs_and_verifies(demo_log, tmp_path):
    path = tmp_path / "map"
    few = ("--frames", "10", "--viewer", "none", "--set", "mapper.mapping.requests.max_failures=0")
    play = ("play", demo_log, "--out", path, *few, "--set")
    (told,) = refusal(*play, "mapper.run.view_colors=gif").splitlines()
    assert "view_colors" in told and "png" in told
    assert not path.exists()
    said(*play, "mapper.run.view_colors=webp")
    saved = open_map(path)
    assert saved.manifest.processor.startswith(f"{processor_kind()}, codecs of OpenCV ")
    said("verify", path)
    view = next(tracked for tracked in saved.snapshot.objects if tracked.views).views[0]
    (file,) = crop_files(saved.views, view.name)
    file.write_bytes(file.read_bytes()[:-9])
    assert f"cannot read {file}: not a file of this map format" in said("verify", path, status=1)


def test_a_map_folder_keeps_and_removes_views(tmp_path):
    folder = create_map_folder(tmp_path / "m", config={}, source={})
    snapshot = make_snapshot(folder)
    folder.save(snapshot)
    first = snapshot.objects[0]
    dropped, *_ = (view.name for view in first.views)
    (file,) = crop_files(folder.views, dropped)
    folder.drop_view(dropped)
    folder.save(snapshot)
    assert file.exists()
    folder.save(replace(snapshot, objects=(replace(first, views=first.views[1:]), *snapshot.objects[1:])))
    assert not file.exists()
    views = [view for tracked in snapshot.objects for view in tracked.views]
    kept = {file for view in views for file in crop_files(folder.views, view.name)}
    (folder.views / "000077-000.view").write_bytes(b"of a run that was killed")
    (folder.shapes / "superseded.glb").write_bytes(b"old")
    folder.finish(finished_cleanly=True)
    assert set(folder.views.iterdir()) == kept - {file}
    assert sorted(path.name for path in folder.shapes.iterdir()) == ["000001.glb", "000004.glb"]
    assert folder.keep_views([dropped, first.views[1].name]) == {dropped}
