import contextlib
import io
import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
from dataclasses import asdict, dataclass
from types import SimpleNamespace
import cv2
import numpy as np
import psutil
import pytest
import trimesh
from rerun.chunk import RrdReader
from hickory_stream.base.config_text import from_dict, read_config
from hickory_stream.cli import main
from hickory_stream.engine.mapper import Mapper
from hickory_stream.engine.play import play
from hickory_stream.geometry.rigid import apply, from_rotation_translation
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.pictures.raycast import image_colors
from hickory_stream.records import Phase
from hickory_stream.settings import Settings
from hickory_stream.testing import RememberingSink
from players import open_source
from tests.output_forms import checked
from tests.player_scenes import CAMERA, SceneFrame, write_posed_folder

COMMAND = (sys.executable, "-m", "hickory_stream")
NUM_FRAMES = 18
HEAVY = ("numpy", "cv2", "rerun", "numba", "scipy", "trimesh", "open3d", "kiss_icp", "embreex", "asyncio")


@dataclass(frozen=True, kw_only=True)
class Ended:
    status: int
    stdout: str
    stderr: str

    def json(self):
        """Return what standard output holds, which is one JSON value and nothing else."""
        return checked(json.loads(self.stdout))


def run(*arguments):
    done = subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, timeout=170, check=False)
    assert "Traceback" not in done.stderr, done.stderr
    return Ended(status=done.returncode, stdout=done.stdout, stderr=done.stderr)


def look(*arguments):
    """Run a command in this process: starting another one takes longer than most of them do."""
    stdout, stderr = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
        status = main([str(argument) for argument in arguments])
    return Ended(status=status, stdout=stdout.getvalue(), stderr=stderr.getvalue())


def ended_as(status, *arguments):
    """Return how a command ended, which ends with a status."""
    ended = look(*arguments)
    assert ended.status == status, ended.stderr
    return ended


def answer(*arguments, status=0):
    """Return the JSON that a command prints."""
    return ended_as(status, *arguments, "--json").json()


def said(*arguments, status=0):
    """Return what a command prints."""
    return ended_as(status, *arguments).stdout


def refusal(*arguments, status=2):
    """Return why a command is refused: what it writes on standard error."""
    ended = ended_as(status, *arguments)
    assert ended.stdout == "" or "--json" in arguments
    return ended.stderr


EAGER = ("--set", "mapper.mapping.requests.first_sightings=2")
# In a log of three seconds, most is seen for less than the default.
SHORT = "mapper.mapping.lifecycle.confirm_s=0.5"


@pytest.fixture(scope="module")
def made(short_log, short_map, coarse_config, tmp_path_factory):
    """Two maps of the short log: by one worker with a Rerun recording, and by two workers without."""
    folder = tmp_path_factory.mktemp("maps")
    rrd = folder / "run.rrd"
    options = ("--viewer", "none", *EAGER, "--workers", 1, "--rrd", rrd, "--json", "--set", "rerun.texture_px=64")
    one = ended_as(0, "play", short_log, "--config", coarse_config, "--out", folder / "one", *options)
    text = short_map.with_suffix(".said").read_text()
    return SimpleNamespace(by_one=folder / "one", by_two=short_map, rrd=rrd, ended=one, text=text)


def test_one_and_two_workers_and_a_recording_make_the_same_map(made, short_log):
    one, two = (open_map(folder).manifest for folder in (made.by_one, made.by_two))
    assert one.digest == two.digest is not None
    assert made.rrd.stat().st_size > 100_000
    assert two.source["uri"] == str(short_log)
    assert (two.config["run"]["workers"], two.config["shapes"]["fit"]["cells"]) == (2, 16)


def test_play_with_json_says_what_it_made(made):
    answer, saved = made.ended.json(), open_map(made.by_one)
    assert answer["event"] == "finished"
    assert answer["map"] == str(made.by_one)
    assert answer["finished_cleanly"] is True
    assert answer["digest"] == saved.manifest.digest == map_digest(saved.snapshot)
    assert answer["objects"] == len(saved.snapshot.objects) > 5
    assert answer["objects_with_shape"] == sum(tracked.shape is not None for tracked in saved.snapshot.objects) > 5
    candidates = answer["candidates"]
    assert candidates["made"] == candidates["kept"] + candidates["merged"] + candidates["dropped"]
    assert candidates["kept"] == answer["objects"]
    assert candidates["dropped"] == sum(candidates["causes"].values())
    assert answer["ledger"] == saved.ledger
    assert saved.ledger["source"]["frames"] == saved.ledger["frames"]["read"] == NUM_FRAMES


def test_play_ends_with_three_commands_that_work(made):
    _, _, looks = made.text.partition("look at it with:\n")
    inspect, picture, timeline = (line.strip() for line in looks.splitlines())
    assert "candidates became" in made.text
    replay, _, viewer = timeline.partition(" && ")
    for line in (inspect, picture, replay):
        said(*shlex.split(line)[1:])
    recording = made.by_two.with_suffix(".rrd")
    assert viewer == f"rerun --bind 127.0.0.1 {recording}"
    assert recording.is_file()


def test_progress_is_a_json_object_per_line_on_standard_error(made):
    events = [json.loads(line) for line in made.ended.stderr.splitlines()]
    assert {event["event"] for event in events} == {"progress"}
    frames = [event["frames"] for event in events]
    assert frames == sorted(frames)
    assert [event["phase"] for event in events][-1] == "saving"
    assert all(event["total"] == NUM_FRAMES for event in events)


def test_a_log_in_loops_keeps_the_objects_and_the_size(short_log, coarse_config, tmp_path):
    sink = RememberingSink()
    no_shapes = ("mapper.mapping.requests.max_failures=0", SHORT)
    source = open_source(short_log)
    play(
        Mapper(read_config(Settings, coarse_config, no_shapes).mapper, out=tmp_path / "map"), source,
        sinks=lambda _: [(sink, True)], rate=None, loops=4, progress=lambda _: None,
    )  # fmt: skip
    source.close()
    snapshots = {report.index: report.snapshot for report in sink.reports if report.snapshot is not None}
    ends = [max(index for index in snapshots if index < NUM_FRAMES * rounds) for rounds in (1, 3, 4)]
    once, thrice, four_times = (confirmed(snapshots[index]) for index in ends)
    assert abs(len(four_times) - len(once)) <= 3
    # Things that touch are taken for one thing and for two in turn: the number goes up and down.
    assert abs(len(four_times) - len(thrice)) <= 2
    sizes = [sum(len(tracked.points_world) for tracked in objects) for objects in (thrice, four_times)]
    assert sizes[1] <= 1.05 * sizes[0]
    spaces = [snapshots[index].submaps[0].observed_space for index in ends]
    assert len(spaces[2].free) <= 1.02 * len(spaces[1].free)
    assert len(spaces[2].structure) <= 1.02 * len(spaces[1].structure)
    assert max(len(tracked.views) for tracked in four_times) <= 9


def confirmed(snapshot):
    return [tracked for tracked in snapshot.objects if tracked.phase is not Phase.TENTATIVE]


class Playing:
    """A playback in real time that is under way."""

    def __init__(self, log, config, out, *options):
        play = ("play", log, "--config", config, "--out", out, "--viewer", "none", "--rate", "1.0", "--json")
        self._process = subprocess.Popen(
            [*COMMAND, *map(str, play), *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.me = psutil.Process(self._process.pid)

    def events(self):
        """Yield the progress as it comes."""
        for line in self._process.stderr:
            yield json.loads(line)

    def wait_for_children(self):
        """Let the playback go on until it has a shape worker and shapes to come."""
        for event in self.events():
            if event["open_shapes"] and (children := self.me.children(recursive=True)):
                return children
        pytest.fail("the playback ended without a single shape to come")

    def end(self):
        stdout, stderr = self._process.communicate(timeout=120)
        assert "Traceback" not in stderr, stderr
        return Ended(status=self._process.returncode, stdout=stdout, stderr=stderr)


def test_a_batch_maps_as_play_does_and_keeps_what_it_mapped(made, short_log, coarse_config, tmp_path):
    asked = ("batch", short_log, "-o", tmp_path / "out", "--config", coarse_config, "--workers", 1, "--merge", *EAGER)
    told = answer(*asked)
    assert [log["state"] for log in told["logs"]] == ["mapped"]
    assert told["logs"][0]["digest"] == made.ended.json()["digest"]
    assert told["joined"]["pairs"] == 0
    assert [log["was_there"] for log in answer(*asked)["logs"]] == [True]
    assert (tmp_path / "out" / "batch.html").is_file()
    assert "made with another configuration" in refusal("batch", short_log, "-o", tmp_path / "out", "--json")


@pytest.fixture(scope="module")
def blank_log(tmp_path_factory):
    """A folder of images of a bare floor, from above, with exact poses."""
    depth = np.full((CAMERA.height, CAMERA.width), 2000, np.uint16)
    down = from_rotation_translation(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    frames = []
    for i in range(8):
        pose = down.copy()
        pose[:3, 3] = 0.2 * i, 0.0, 2.0
        rgb = np.full((*depth.shape, 3), 120, np.uint8)
        frames.append(SceneFrame(stamp_ns=i, world_from_camera=pose, rgb=rgb, depth_mm=depth))
    return write_posed_folder(tmp_path_factory.mktemp("blank") / "blank", frames)


def test_a_run_that_found_no_object_ends_with_status_3(blank_log, tmp_path):
    ended = ended_as(3, "play", blank_log, "--out", tmp_path / "map", "--viewer", "none")
    assert re.search(r"found no object in \d+ keyframes?; .*`hickory-stream doctor LOG`", ended.stderr)
    assert "found no object" in ended_as(3, "inspect", tmp_path / "map").stderr
    batch = answer("batch", blank_log, "-o", tmp_path / "out", "--workers", 1, status=3)
    assert batch["finished"] is False
    assert "found no object" in batch["logs"][0]["reason"]


def test_a_log_without_any_depth_ends_with_status_3(blank_log, tmp_path):
    dark = shutil.copytree(blank_log, tmp_path / "dark")
    for image in (dark / "depth").iterdir():
        cv2.imwrite(str(image), np.zeros((CAMERA.height, CAMERA.width), np.uint16))
    assert "no depth" in ended_as(3, "play", dark, "--out", tmp_path / "map", "--viewer", "none").stderr


def test_a_signal_ends_with_status_130_and_a_map_that_opens(short_log, coarse_config, tmp_path):
    playing = Playing(short_log, coarse_config, tmp_path / "map", *EAGER)
    children = playing.wait_for_children()
    playing.me.send_signal(signal.SIGINT)
    ended = playing.end()
    assert ended.status == 130
    assert ended.json()["finished_cleanly"] is False
    saved = open_map(tmp_path / "map")
    assert not saved.manifest.finished_cleanly
    assert saved.snapshot.objects
    assert 0 < saved.ledger["frames"]["read"] < NUM_FRAMES
    command = f"hickory-stream resume {tmp_path / 'map'}"
    assert ended.json()["resume"] == command
    small = ("render", "-o", tmp_path / "map.png", "--size", "480x240")
    for looking in (("inspect",), small, ("export", "-o", tmp_path / "map.json")):
        assert f"continue with: {command}" in look(*looking[:1], tmp_path / "map", *looking[1:]).stderr
    assert saved.manifest.digest == map_digest(saved.snapshot) == ended.json()["digest"]
    assert not any(child.is_running() and child.status() != psutil.STATUS_ZOMBIE for child in children)


def test_a_second_signal_cancels_at_once_and_leaves_no_child(short_log, coarse_config, tmp_path):
    patient = ("--set", "mapper.run.grace_s=1000.0", "--set", "mapper.run.job_timeout_s=1000.0")
    playing = Playing(short_log, coarse_config, tmp_path / "map", *EAGER, *patient)
    children = playing.wait_for_children()
    for child in children:
        child.send_signal(signal.SIGSTOP)
    playing.me.send_signal(signal.SIGINT)
    with pytest.raises(psutil.TimeoutExpired):
        playing.me.wait(2.0)
    playing.me.send_signal(signal.SIGINT)
    ended = playing.end()
    assert ended.status == 130
    assert "cancelled" in ended.json()["message"]
    assert f"continue with: hickory-stream resume {tmp_path / 'map'}" in ended.json()["message"]
    assert not open_map(tmp_path / "map").manifest.finished_cleanly
    assert not any(child.is_running() and child.status() != psutil.STATUS_ZOMBIE for child in children)


def test_a_full_disk_stops_with_status_2_and_keeps_the_map(short_log, coarse_config, tmp_path):
    if not hasattr(psutil, "RLIMIT_FSIZE"):
        pytest.skip("the limit on file sizes of another process can be set on Linux only")
    playing = Playing(short_log, coarse_config, tmp_path / "map", *EAGER, "--set", "disk.every_keyframes=1")
    for _ in playing.events():
        if (tmp_path / "map/objects.json").exists():
            break
    # Every write beyond 64 bytes fails from now on, as it does on a full disk.
    playing.me.rlimit(psutil.RLIMIT_FSIZE, (64, 64))
    ended = playing.end()
    assert ended.status == 2
    assert "cannot write" in ended.json()["message"]
    assert "--out" in ended.json()["message"]
    assert ended.stderr.splitlines()[-1] == f"hickory-stream: {ended.json()['message']}"
    saved = open_map(tmp_path / "map")
    assert not saved.manifest.finished_cleanly
    assert saved.snapshot.objects


def test_inspect_shows_every_object_and_with_json_the_digest(made):
    table, answer = look("inspect", made.by_one), look("inspect", made.by_one, "--json").json()
    saved = open_map(made.by_one)
    assert answer["digest"] == saved.manifest.digest
    assert [entry["id"] for entry in answer["objects"]] == [tracked.id for tracked in saved.snapshot.objects]
    first_words = {line.split()[0] for line in table.stdout.splitlines() if line.split()}
    assert {str(tracked.id) for tracked in saved.snapshot.objects} <= first_words


def test_render_draws_the_layers_that_are_asked_for(made, tmp_path):
    pictures = []
    for layers in ("1,2", "3,4"):
        picture = tmp_path / f"{layers}.png"
        drawn = answer("render", made.by_one, "-o", picture, "--layers", layers, "--size", "640x320")
        assert drawn["picture"] == str(picture)
        pictures.append(cv2.imread(str(picture)))
    assert pictures[0].shape == pictures[1].shape == (320, 640, 3)
    assert (pictures[0] != pictures[1]).mean() > 0.01
    assert all(len(set(picture.reshape(-1, 3).mean(axis=1).round().tolist())) > 20 for picture in pictures)


def test_output_is_reported_and_replaced_only_when_asked(made, tmp_path):
    for command, option, out in (
        (("render", made.by_one, "--size", "480x240"), "-o", tmp_path / "map.png"),
        (("export", made.by_one, "--format", "glb", "--texture", 0), "-o", tmp_path / "map.glb"),
        (("replay", made.by_one), "--rrd", tmp_path / "run.rrd"),
    ):
        first = said(*command, option, out)
        assert re.search(rf"^{re.escape(str(out))}: [\d.]+ (KiB|MiB)$", first, flags=re.MULTILINE)
        written = out.read_bytes()
        assert f"{out} exists; replace it with --overwrite" in refusal(*command, option, out)
        assert out.read_bytes() == written
    out = tmp_path / "map.png"
    said("render", made.by_one, "--size", "640x320", "-o", out, "--overwrite")
    assert cv2.imread(str(out)).shape == (320, 640, 3)


def test_an_exported_glb_is_y_up_with_seen_and_unseen_surface(made, tmp_path):
    said("export", made.by_one, "--format", "glb", "--texture", 0, "-o", tmp_path / "map.glb")
    scene = trimesh.load(tmp_path / "map.glb", force="scene")
    content = (tmp_path / "map.glb").read_bytes()
    document = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
    assert all("_SEEN" in mesh["primitives"][0]["attributes"] for mesh in document["meshes"])
    saved = open_map(made.by_one)
    shapes = {f"{t.kind}-{t.id}": t.shape for t in saved.snapshot.objects if t.shape is not None}
    assert set(scene.graph.nodes_geometry) == set(shapes)
    for name, shape in shapes.items():
        mesh = saved.mesh(shape)
        pose, geometry = scene.graph[name]
        x, y, z = apply(shape.world_from_object, np.asarray(mesh.vertices, dtype=np.float64)).T
        exported = apply(pose, np.asarray(scene.geometry[geometry].vertices, dtype=np.float64))
        # glTF: x right, y up, z towards us.
        assert np.allclose(np.sort(exported, axis=0), np.sort(np.stack([x, z, -y], axis=1), axis=0), atol=1e-4)
        seen = scene.geometry[geometry].vertex_attributes["_SEEN"]
        assert int(np.asarray(seen).sum()) == int(mesh.is_seen.sum())


def test_an_exported_glb_has_a_texture_on_every_object(made, tmp_path):
    said("export", made.by_one, "--format", "glb", "--texture", 64, "-o", tmp_path / "map.glb")
    scene = trimesh.load(tmp_path / "map.glb", force="scene")
    saved = open_map(made.by_one)
    for tracked in saved.snapshot.objects:
        if tracked.shape is not None:
            shown, mesh = scene.geometry[f"{tracked.kind}-{tracked.id}"], saved.mesh(tracked.shape)
            image = np.asarray(shown.visual.material.baseColorTexture)
            assert max(image.shape[:2]) <= 64
            # The image has the colours of the vertices, where they are seen, but for what is finer than a vertex.
            colors = image_colors(image, np.column_stack([shown.visual.uv[:, 0], 1 - shown.visual.uv[:, 1]])) * 255
            assert np.abs(colors.mean(axis=0) - mesh.colors.mean(axis=0)).max() < 40
            assert shown.is_watertight or len(shown.vertices) > len(mesh.vertices)


def test_textures_come_with_the_viewer_and_pictures_on_request(made, tmp_path):
    textured = {
        chunk.entity_path
        for chunk in RrdReader(made.rrd).stream()
        if any("albedo_texture" in name for name in chunk.to_record_batch().schema.names)
    }
    assert len(textured) == sum(tracked.shape is not None for tracked in open_map(made.by_one).snapshot.objects)
    pictures = []
    for texture in (0, 64):
        out = tmp_path / f"{texture}.png"
        said("render", made.by_one, "-o", out, "--layers", 2, "--size", "480x240", "--texture", texture)
        pictures.append(cv2.imread(str(out)).astype(int))
    assert 0 < np.abs(pictures[0] - pictures[1]).mean() < 10


def test_a_damaged_view_is_named_and_texture_0_still_exports(made, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(made.by_one, broken)
    view = next(t for t in open_map(broken).snapshot.objects if t.shape is not None).views[0].name
    colors = broken / "views" / f"{view}.view"
    colors.write_bytes(colors.read_bytes()[:100])
    command = ("export", broken, "--format", "glb", "-o", tmp_path / "b.glb", "--texture")
    (refused,) = refusal(*command, 32).splitlines()
    assert view in refused and "--texture 0" in refused
    said(*command, 0)


@pytest.mark.parametrize("side", ["31", "9000", "x", "-1"])
def test_a_texture_of_no_possible_side_is_refused(side, capsys):
    with pytest.raises(SystemExit):
        main(["export", "any.map", "--format", "glb", f"--texture={side}"])
    assert "expected 32 to 8192 pixels" in capsys.readouterr().err


@pytest.mark.parametrize("form", ["text", "json"])
def test_a_log_finds_itself_in_its_map_and_stops_there(made, short_log, coarse_config, form):
    options = ("--config", coarse_config, "--set", SHORT, "--until-found", *(("--json",) if form == "json" else ()))
    ended = ended_as(0, "relocalise", made.by_one, short_log, *options)
    if form == "json":
        last = [json.loads(line) for line in ended.stdout.splitlines()][-1]
        assert (last["event"], last["confirmed"]) == ("located", True)
        assert np.allclose(last["map_from_log"], np.eye(4), atol=0.02)
        assert ended.stderr == ""
    else:
        assert "confirmed" in ended.stdout
        assert "ERROR" not in ended.stderr
        assert ended.stderr.count(", confirmed") == ended.stderr.count("first answer, not confirmed") == 1


def test_the_dumped_configuration_is_valid_and_the_default(tmp_path):
    dumped = said("config", "dump")
    (tmp_path / "robot.toml").write_text(dumped)
    assert from_dict(Settings, tomllib.loads(dumped)) == Settings()
    assert said("config", "check", tmp_path / "robot.toml") == f"{tmp_path / 'robot.toml'}: ok\n"
    as_json = answer("config", "dump", "--set", "mapper.run.workers=7")
    assert (as_json["mapper"]["run"]["workers"], as_json["disk"]) == (7, asdict(Settings().disk))


@pytest.mark.parametrize("arguments", [("--help",), ("play", "--help"), ("--version",)])
def test_help_answers_without_loading_what_it_does_not_need(arguments):
    script = (
        "import sys; from hickory_stream.cli import main\n"
        "try: main(sys.argv[1:])\n"
        f"finally: sys.stderr.write(' '.join(name for name in {HEAVY} if name in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert re.search(r"hickory-stream \d+\S*\n$" if arguments == ("--version",) else "hickory-stream", done.stdout)


@pytest.mark.parametrize("arguments", [(), ("fly",), ("play", "x", "--loop", "many")])
def test_a_bad_command_line_exits_with_2_and_shows_the_usage(arguments):
    ended = run(*arguments)
    assert (ended.status, ended.stdout) == (2, "")
    assert ended.stderr.startswith("usage: hickory-stream")


def test_play_without_a_log_says_what_it_takes():
    expected = "found no log, expected play LOG [LOG ...], or --robot NAME=LOG for each robot of a fleet"
    assert refusal("play") == f"hickory-stream: {expected}\n"
