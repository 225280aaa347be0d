import json
import re
import sys
from dataclasses import replace
import numpy as np
import psutil
import pytest
from hickory_stream.box_scene import SCENE_BOXES, SceneSource
from hickory_stream.cli import main
from hickory_stream.config import MapperConfig, RunConfig
from hickory_stream.engine.shape_jobs.generators.choose import (
    ExternalGenerator,
    chosen_generator,
    generator_key,
    reconstructor_of,
)
from hickory_stream.engine.shape_jobs.generators.exchange import read_answer, write_question
from hickory_stream.engine.shape_jobs.generators.spec import cluster_resources, fingerprint, read_spec
from hickory_stream.errors import ConfigError, WorkerError
from hickory_stream.geometry.camera import backproject
from hickory_stream.inspection.inspect import summarize
from hickory_stream.map_folder.history.recorded import recorded_steps
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.views import read_crop
from hickory_stream.ports import NoShape, ShapeInputs
from hickory_stream.shapes.build import ShapeConfig, make_reconstructor
from hickory_stream.testing import InstanceSegmenter
from tests.engine.run_fixtures import map_scene, scene_request
from tests.examples.box_generator import answer
from tests.examples.generators import HERE, box_generator, box_spec
from tests.output_forms import checked

TOML = """
name = "box-generator"
command = ["{python}", "box_generator.py"]
licence = "research only"
acceptance = "I do research"
weights = ["weights.bin"]
[environment]
LEVEL = 3
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A box, seen from four places."""
    views = tmp_path_factory.mktemp("views")
    asked = scene_request(views, num_views=4)
    return ShapeInputs(
        crops=tuple(read_crop(views, view.name) for view in asked.views), points_world=asked.points_world,
        colors=asked.colors, box=asked.box, support_z_m=asked.support_z_m,
    )  # fmt: skip


@pytest.fixture
def toml(tmp_path):
    (tmp_path / "box_generator.py").write_text((HERE / "box_generator.py").read_text())
    (tmp_path / "weights.bin").write_bytes(b"1234")
    path = tmp_path / "box.toml"
    path.write_text(TOML.replace("{python}", sys.executable))
    return path


def config(toml, i_accept="I do research"):
    run = RunConfig(generator=str(toml), accept_licence=i_accept)
    return MapperConfig(run=run, shapes=ShapeConfig(reconstructor="external"))


def test_a_generated_shape_replaces_the_embedded_one(inputs):
    made = make_reconstructor("external", ShapeConfig(), box_generator()).reconstruct(inputs)
    assert made.made_by == "box-generator"
    assert "accepted" in made.verdict
    assert "placed at " in made.verdict
    assert 0 < made.mesh.is_seen.sum() < len(made.mesh.is_seen)


@pytest.mark.parametrize(("misdeed", "said"), [
    ("torn", "not usable"), ("nan", "not finite|finite float32"), ("huge", "not usable"), ("outside", "not usable"),
    ("another", "another job"), ("none", "hardly any depth"),
])  # fmt: skip
def test_a_hostile_answer_is_no_mesh(inputs, tmp_path, misdeed, said):
    job = write_question(tmp_path, inputs, 1)
    answer(tmp_path, job, [misdeed])
    try:
        found = read_answer(tmp_path, job, 1)
    except WorkerError as error:
        found = NoShape(reason=str(error))
    assert re.search(said, found.reason), found.reason


def test_one_that_crashes_is_started_anew_and_then_given_up(inputs):
    found = ExternalGenerator(box_spec("crash")).generate(inputs)
    assert "ended with status 3" in found.reason
    assert not found.hit_limit


@pytest.mark.parametrize("misdeed", ["hang", "grow"])
def test_a_hanging_or_growing_generator_is_ended(inputs, misdeed):
    assert ExternalGenerator(box_spec(misdeed, time_s=1.0, memory_mb=300.0)).generate(inputs).hit_limit
    assert not [child for child in psutil.Process().children() if misdeed in child.cmdline()]


def test_the_embedded_shape_stays_where_the_generated_is_refused(inputs):
    class Fails:
        name = "fails"

        def generate(self, inputs):
            del inputs
            return NoShape(reason="no memory", hit_limit=True)

    made = make_reconstructor("external", ShapeConfig(), Fails()).reconstruct(inputs)
    own = make_reconstructor("fused", ShapeConfig()).reconstruct(inputs)
    assert made.mesh.vertices.tobytes() == own.mesh.vertices.tobytes()
    assert (made.made_by, made.verdict, made.hit_limit) == ("fused", "fails: no memory", True)


def test_equal_questions_have_equal_names(inputs, tmp_path):
    job = write_question(tmp_path, inputs, 2)
    (tmp_path / "again").mkdir()
    assert job == write_question(tmp_path / "again", inputs, 2)
    assert job != write_question(tmp_path / "again", inputs, 1)
    depth = np.load(tmp_path / "depth.npy")
    crop = inputs.crops[0]
    assert np.array_equal(depth > 0, np.isfinite(crop.depth_m))
    said = json.loads((tmp_path / "camera.json").read_text())
    points = backproject(crop.depth_m, crop.camera)
    row, column = np.argwhere(crop.mask & np.isfinite(crop.depth_m))[0]
    assert (column - said["cx"]) / said["fx"] * depth[row, column] == pytest.approx(points[row, column, 0], abs=1e-6)
    assert (tmp_path / "views" / "1" / "rgb.png").is_file()
    assert not (tmp_path / "views" / "2").exists()


@pytest.mark.parametrize(
    "rows", [[[1, 0], [0, 1]], np.diag([1.0, 1, -1, 1]).tolist(), np.full((4, 4), np.nan).tolist(), "up"]
)
def test_a_pose_that_is_no_similarity_is_refused(tmp_path, rows):
    (tmp_path / "mesh.glb").write_bytes(b"glTF")
    (tmp_path / "result.json").write_text(json.dumps({"job": "a", "camera_from_mesh": rows}))
    with pytest.raises(WorkerError, match="not usable"):
        read_answer(tmp_path, "a", 1)


def test_a_generator_that_cannot_start_is_refused_with_the_reason(toml):
    with pytest.raises(ConfigError, match=r'run\.accept_licence = "I do research"'):
        chosen_generator(config(toml, i_accept=""))
    (toml.parent / "box_generator.py").write_text("raise SystemExit(7)")
    with pytest.raises(ConfigError, match="ended with status 7"):
        chosen_generator(config(toml))
    (toml.parent / "weights.bin").unlink()
    with pytest.raises(ConfigError, match=r"lacks the weights .*weights.bin"):
        chosen_generator(config(toml))


def test_a_startable_generator_is_chosen_and_is_in_the_cache_key(toml):
    assert chosen_generator(config(toml)) == toml
    before = generator_key(config(toml))
    (toml.parent / "weights.bin").write_bytes(b"12345")
    assert generator_key(config(toml)) != before
    assert generator_key(MapperConfig()) == ""
    assert fingerprint(read_spec(toml)) == fingerprint(replace(read_spec(toml), time_s=1.0))


@pytest.mark.parametrize(("text", "said"), [
    ('name = "a"', "lacks command"), ('name = "a"\ncommand = ["b"]\ntime_s = -1', "time_s"),
    ('name = "a"\ncommand = ["b"]\nspeed = 3', "speed"), ('name = "a"\ncommand = []', "must not be empty"),
    ("name = ", "is not TOML"),
])  # fmt: skip
def test_a_toml_that_describes_no_generator_is_refused(tmp_path, text, said):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(ConfigError, match=said):
        read_spec(tmp_path / "a.toml")


def test_a_job_never_names_the_program(monkeypatch):
    monkeypatch.delenv("HICKORY_GENERATOR", raising=False)
    with pytest.raises(ConfigError, match="HICKORY_GENERATOR"):
        reconstructor_of(ShapeConfig(reconstructor="external"))


def test_a_run_reports_the_generators_shapes(tmp_path, toml):
    chosen = ("shapes.reconstructor=external", f"run.generator={toml}", "run.accept_licence=I do research")
    (tracked,) = map_scene(tmp_path, *chosen, boxes=SCENE_BOXES[-1:], child_workers=True).snapshots[-1].objects
    assert tracked.shape.reconstructor == "box-generator"
    (summary,) = summarize(open_map(tmp_path / "map")).objects
    assert summary.verdict == tracked.shape.verdict
    assert "accepted: explains" in summary.verdict


def test_made_up_surface_is_withdrawn_when_free_space_is_seen(tmp_path, toml, capsys, monkeypatch):
    # As in the worker of the test before.
    monkeypatch.setenv("HICKORY_GENERATOR", str(toml))
    toml.write_text(toml.read_text().replace('"box_generator.py"]', '"box_generator.py", "deep"]'))
    chosen = ("shapes.reconstructor=external", f"run.generator={toml}", "run.accept_licence=I do research")
    # All else that would ask again is switched off.
    rare = (
        "mapping.requests.interval_s=0", "mapping.requests.min_gain=1.95", "mapping.requests.final_gain=9",
        "shapes.judgement.max_less=0.3",
    )  # fmt: skip
    walk = SceneSource(14, SCENE_BOXES[-1:], step_of=lambda i: i // 2 if i < 6 else 3 * i - 15)
    run = map_scene(tmp_path, *chosen, *rare, source=walk, segmenter=InstanceSegmenter(walk.instances))
    steps = recorded_steps(tmp_path / "map", run.snapshots[-1])
    told = [decision.text for step in steps for decision in step.decisions if decision.kind == "shape"]
    shapes = [snapshot.objects[0].shape for snapshot in run.snapshots if snapshot.objects]
    generated = [shape for shape in shapes if shape is not None]
    assert generated[0].is_generated
    again = next(i for i, text in enumerate(told) if "of its generated shape was seen to be free" in text)
    assert told[again + 1].startswith("job 2 asked for")
    # What is made of more views is cut where they saw through it.
    claimed = [float(8 * shape.fitted.semi_axes_m.prod(axis=1).sum()) for shape in (generated[0], generated[-1])]
    true = float(np.prod(np.subtract(SCENE_BOXES[-1].high, SCENE_BOXES[-1].low)))
    assert abs(claimed[1] - true) < 0.5 * (claimed[0] - true)
    assert main(["diff", str(tmp_path / "map"), "2", "3.9"]) == 0
    assert re.search(r"^#1 +shape changed ", capsys.readouterr().out, flags=re.MULTILINE)


def test_check_says_what_a_generator_is_gives_and_takes(toml, tmp_path, capsys, monkeypatch):
    assert main(["generators", "check", str(toml), "-o", str(tmp_path / "a.png"), "--json"]) == 0
    said = checked(json.loads(capsys.readouterr().out))
    assert (said["state"], said["is_usable"], said["said"]["model"]) == ("ok", True, "box")
    assert (tmp_path / "a.png").is_file()
    (toml.parent / "weights.bin").unlink()
    assert main(["generators", "check", str(toml)]) == 1
    assert "lacks the weights" in capsys.readouterr().out
    monkeypatch.setenv("HICKORY_GENERATORS", str(tmp_path))
    assert main(["generators", "list"]) == 0
    assert "research only  lacks the weights" in capsys.readouterr().out


def test_a_cluster_is_asked_for_what_the_generator_needs(toml):
    text = toml.read_text()
    toml.write_text(text + "\n[resources]\nGPU = 1\nMEMORY = 2e9\n")
    assert cluster_resources(read_spec(toml)) == {"GPU": 1.0, "MEMORY": 2e9}
    toml.write_text(text + '\n[resources]\nGPU = "one"\n')
    with pytest.raises(ConfigError, match=r"GPU is 'one'; expected a number above 0"):
        cluster_resources(read_spec(toml))
