import json
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.engine.shape_jobs.job_folder import job_folder, read_job, take_result, write_job, write_result
from hickory_stream.errors import MapFolderError, WorkerError
from hickory_stream.geometry.codecs.mesh_file import mesh_of_file
from hickory_stream.geometry.mesh import sha256_of
from hickory_stream.map_folder.views import crop_files, read_crop
from hickory_stream.ports import NoShape
from hickory_stream.shapes.build import build_shape
from hickory_stream.testing import BoxReconstructor
from tests.engine.run_fixtures import scene_config, scene_request


@pytest.fixture
def config(tmp_path):
    return scene_config(tmp_path / "config").shapes


@pytest.fixture
def request_3(tmp_path):
    (tmp_path / "views").mkdir()
    return scene_request(tmp_path / "views")


def written(tmp_path, request, config):
    folder = job_folder(tmp_path / "jobs", request.ticket)
    write_job(folder, request, tmp_path / "views", config)
    return folder


def built(folder):
    inputs, config = read_job(folder)
    return build_shape(inputs, BoxReconstructor(), config)


def test_a_worker_reads_what_was_asked_for(tmp_path, request_3, config):
    config = replace(config, reconstructor="single_view")
    inputs, read = read_job(written(tmp_path, request_3, config))
    assert read == config
    assert inputs.support_z_m == 0.0
    np.testing.assert_array_equal(inputs.points_world, request_3.points_world)
    np.testing.assert_array_equal(inputs.colors, request_3.colors)
    np.testing.assert_array_equal(inputs.box.world_from_box, request_3.box.world_from_box)
    np.testing.assert_array_equal(inputs.box.half_extents_m, request_3.box.half_extents_m)
    for crop, view in zip(inputs.crops, request_3.views, strict=True):
        kept = read_crop(tmp_path / "views", view.name)
        np.testing.assert_array_equal(crop.depth_m, kept.depth_m)
        np.testing.assert_array_equal(crop.world_from_camera, view.world_from_camera)


def test_a_view_may_be_dropped_while_its_job_waits(tmp_path, request_3, config):
    folder = written(tmp_path, request_3, config)
    for view in request_3.views:
        for file in crop_files(tmp_path / "views", view.name):
            file.unlink()
    assert len(read_job(folder)[0].crops) == len(request_3.views)


def test_a_disk_that_refuses_a_job_is_told_as_such(tmp_path, request_3, config):
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs/000001").write_text("in the way")
    with pytest.raises(MapFolderError, match=r"cannot write .*000001"):
        written(tmp_path, request_3, config)


def test_the_answer_is_the_shape_that_was_built(tmp_path, request_3, config):
    folder, shapes = written(tmp_path, request_3, config), tmp_path / "shapes"
    shapes.mkdir()
    answer = built(folder)
    write_result(folder, answer, "box")
    taken = take_result(folder, 1, 3, shapes)
    shape = taken.shape
    assert (shape.reconstructor, shape.revision, shape.mesh_name) == ("box", 1, "000003-000001.mesh")
    np.testing.assert_array_equal(shape.fitted.semi_axes_m, answer.fitted.semi_axes_m)
    np.testing.assert_array_equal(shape.inflated.world_from_local, answer.inflated.world_from_local)
    np.testing.assert_array_equal(shape.world_from_object, answer.reconstruction.world_from_object)
    np.testing.assert_array_equal(shape.seen_share, answer.seen_share)
    assert shape.containment == answer.containment
    assert set(taken.timings_s) == {"reconstruct", "fit", "inflate"}


def test_the_hash_fits_the_mesh_and_the_job_stays_until_written(tmp_path, request_3, config):
    folder, shapes = written(tmp_path, request_3, config), tmp_path / "shapes"
    shapes.mkdir()
    write_result(folder, built(folder), "box")
    shape = take_result(folder, 1, 3, shapes).shape
    assert sha256_of(mesh_of_file((shapes / shape.mesh_name).read_bytes())) == shape.mesh_sha256
    assert folder.exists()


def test_the_reason_for_no_shape_comes_back(tmp_path, request_3, config):
    folder = written(tmp_path, request_3, config)
    write_result(folder, NoShape(reason="too thin"), "")
    taken = take_result(folder, 1, 3, tmp_path / "shapes")
    assert (taken.shape, taken.reason) == (None, "too thin")
    assert folder.exists()


@pytest.mark.parametrize("damage", ["missing", "empty", "cut", "keys", "mesh"])
def test_a_damaged_answer_is_a_worker_error_that_names_the_job(tmp_path, request_3, config, damage):
    folder, shapes = written(tmp_path, request_3, config), tmp_path / "shapes"
    shapes.mkdir()
    write_result(folder, built(folder), "box")
    result = folder / "result.json"
    text = result.read_text()
    if damage == "missing":
        result.unlink()
    elif damage == "mesh":
        (folder / "shape.mesh").write_bytes(b"HSM2" + bytes(40))
    else:
        keys = json.dumps({"reconstructor": "box"})
        result.write_text({"empty": "", "cut": text[: len(text) // 2], "keys": keys}[damage])
    with pytest.raises(WorkerError, match=r"job 1: no readable answer in .*000001"):
        take_result(folder, 1, 3, shapes)
