import json
import shutil
from dataclasses import replace
from pathlib import Path
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from hickory_stream.config import MapperConfig
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.data_sets import open_truth
from hickory_stream.evaluation.truth import load_truth, mesh_of
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.shapes.build import ShapeConfig
from hickory_stream.worlds.recording import make_recording
from hickory_stream.worlds.room import furnished_room
from players import open_source
from tools.evaluation.view_trials import OURS, STRATEGIES, try_views
from tools.paper_tables.counterparts import write_hope, write_replica_cad
from tools.paper_tables.data_sets import DATA_SETS, HOPE, KIMERA_MULTI
from tools.paper_tables.logs import kimera_pairs
from tools.paper_tables.published import ALIGNMENT, VIEWS
from tools.paper_tables.replica_cad import read_apartment, scene_names
from tools.paper_tables.tables import Cell, Column, Table, as_csv, as_json, chart, markdown
from tools.paper_tables.workshop import QUICK, Workshop
from tools.worlds.recording_config import RecordingConfig, drawn_frame
from tools.worlds.routes import clearance_of_surfaces


@pytest.fixture(scope="module")
def hope_root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hope")
    config = RecordingConfig(scene="tabletop", seed=3, seconds=0.5, rate_hz=4.0, width=160, height=120)
    truth = make_recording(config, folder, "table")
    root = folder / "hope-dataset"
    write_hope(folder / "table.mcap", truth, root / "hope_video" / "scene_0000", root / "meshes" / "eval")
    return root


def bounds(points):
    return points.min(axis=0), points.max(axis=0)


def test_a_scene_of_hope_has_the_true_objects(hope_root):
    found = open_truth(hope_root / "hope_video" / "scene_0000")
    expected = load_truth(hope_root.parent / "table.truth")
    assert len(found.objects) == len(expected.objects)
    by_name = {f"scene_0000_{item.id:02d}_{item.kind}": item for item in expected.objects}
    seen = []
    for item in found.objects:
        true = by_name[item.kind]
        points = apply(item.world_from_object, mesh_of(found, item).vertices.astype(np.float64))
        expected_points = apply(true.world_from_object, mesh_of(expected, true).vertices.astype(np.float64))
        np.testing.assert_allclose(bounds(points), bounds(expected_points), atol=1e-3)
        seen.append((item.seen_fraction, true.seen_fraction))
    shares = np.array(seen)
    assert shares[:, 1].max() > 0.2
    np.testing.assert_allclose(shares[:, 0], shares[:, 1], atol=0.12)


def test_other_units_and_missing_meshes_are_refused_by_name(hope_root, tmp_path):
    scene = tmp_path / "scene_0000"
    scene.mkdir()
    for file in (hope_root / "hope_video" / "scene_0000").iterdir():
        if file.suffix != ".json":
            (scene / file.name).write_bytes(file.read_bytes())
            continue
        record = json.loads(file.read_bytes())
        for row in record["camera"]["extrinsics"][:3]:
            row[3] *= 100.0
        (scene / file.name).write_text(json.dumps(record))
    with pytest.raises(RecordingError, match=r"moves by .* m between frames; expected .* extrinsics in metres"):
        open_truth(scene)
    alone = Path(shutil.copytree(hope_root / "hope_video" / "scene_0000", tmp_path / "hope_video" / "scene_0000"))
    with pytest.raises(RecordingError, match=r"scene_0000_01_.*\.obj cannot be read as a mesh"):
        open_truth(alone)
    _apartment(tmp_path / "apartment", {}, {})
    (tmp_path / "apartment" / "objects" / "brick.glb").unlink()
    with pytest.raises(RecordingError, match=r"brick\.glb is missing: the mesh of brick"):
        read_apartment(tmp_path / "apartment", "apt_0")


def test_an_apartment_that_was_written_is_read_as_it_was(tmp_path):
    world = furnished_room(5)
    write_replica_cad(world, tmp_path, "apt_0")
    assert scene_names(tmp_path) == ["apt_0"]
    found = read_apartment(tmp_path, "apt_0")
    assert len(found.objects) == len(world.objects)
    for item, true in zip(found.objects, world.objects, strict=True):
        corners = [
            apply(one.world_from_object, np.concatenate([part.vertices for part in one.model.parts]))
            for one in (item, true)
        ]
        np.testing.assert_allclose(bounds(corners[0]), bounds(corners[1]), atol=1e-3)
    clear = clearance_of_surfaces(found)
    x, y = world.middle_m
    assert clear.distance_m.max() > 0.5
    assert clear.at(np.array([[x + 30.0, y]])) == 0.0


def _apartment(root, instance, config):
    """Write an apartment with a floor and one brick of 0.2 x 0.4 x 0.6 m (y up), whose origin is a corner."""
    for folder in ("configs/scenes", "configs/objects", "objects", "stages"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    floor = trimesh.creation.box(extents=(6.0, 0.1, 4.0))
    floor.apply_translation((0.0, -0.05 + 1.5, 0.0))
    floor.export(root / "stages" / "plain.glb")
    brick = trimesh.creation.box(extents=(0.2, 0.4, 0.6))
    brick.apply_translation((0.1, 0.2, 0.3))
    brick.visual.face_colors = [200, 40, 40, 255]
    brick.export(root / "objects" / "brick.glb")
    described = json.dumps({"render_asset": "../../objects/brick.glb", **config})
    (root / "configs/objects/brick.object_config.json").write_text(described)
    objects = [{"template_name": "brick", **instance}]
    scene = {"stage_instance": {"template_name": "stages/plain"}, "object_instances": objects}
    (root / "configs/scenes/apt_0.scene_instance.json").write_text(json.dumps(scene))


QUARTER = [float(np.sqrt(0.5)), 0.0, float(np.sqrt(0.5)), 0.0]


@pytest.mark.parametrize(
    ("instance", "config", "low", "high"),
    [
        # By its own origin; a quarter turn about y (up) takes x to -z, which is y in our world, and z to x.
        ({"translation_origin": "asset_local"}, {}, (0.0, -0.6, 0.0), (0.2, 0.0, 0.4)),
        ({"translation_origin": "ASSET_LOCAL", "rotation": QUARTER}, {}, (0.0, 0.0, 0.0), (0.6, 0.2, 0.4)),
        # By the middle of its box, which is what Habitat takes where nothing is said, and by a given centre of mass.
        ({}, {}, (-0.1, -0.3, -0.2), (0.1, 0.3, 0.2)),
        ({"translation_origin": "COM"}, {"COM": [0.1, 0.0, 0.3]}, (-0.1, -0.3, 0.0), (0.1, 0.3, 0.4)),
        ({"translation_origin": "asset_local", "uniform_scale": 2.0}, {}, (0.0, -1.2, 0.0), (0.4, 0.0, 0.8)),
    ],
)
def test_objects_stand_where_habitat_puts_them(tmp_path, instance, config, low, high):
    _apartment(tmp_path, {"translation": [1.0, 1.5, 0.5], **instance}, config)
    (item,) = read_apartment(tmp_path, "apt_0").objects
    corners = apply(item.world_from_object, item.model.bounds_m())
    np.testing.assert_allclose(bounds(corners), np.add((low, high), (1.0, -0.5, 0.0)), atol=1e-6)
    red, green, _ = item.model.parts[0].texture.first
    assert red > 3 * green


def test_an_articulated_thing_stands_as_at_joint_zero(tmp_path):
    _apartment(tmp_path, {"translation": [0.0, 2.0, 0.0]}, {})
    folder = tmp_path / "urdf" / "drawer"
    folder.mkdir(parents=True)
    trimesh.creation.box(extents=(0.2, 0.2, 0.2)).export(folder / "box.glb")
    turn = Rotation.from_euler("xyz", (0.0, 0.0, np.pi / 2)).as_euler("xyz")
    shown = "<visual><origin xyz='0.5 0 0'/><geometry><mesh filename='box.glb'/></geometry></visual>"
    (folder / "drawer.urdf").write_text(
        f"<robot name='d'><link name='base'/><link name='tray'>{shown}</link><joint name='j' type='prismatic'>"
        f"<parent link='base'/><child link='tray'/><origin xyz='0 0 1' rpy='{turn[0]} {turn[1]} {turn[2]}'/>"
        "</joint></robot>"
    )
    path = tmp_path / "configs/scenes/apt_0.scene_instance.json"
    scene = json.loads(path.read_text())
    scene["articulated_object_instances"] = [{"template_name": "drawer", "translation": [0.0, 1.5, 0.0]}]
    path.write_text(json.dumps(scene))
    tray = read_apartment(tmp_path, "apt_0").objects[1]
    middle = apply(tray.world_from_object, tray.model.bounds_m()).mean(axis=0)
    # In the URDF at (0, 0.5, 1); y up there is z up here, and z there is -y here.
    np.testing.assert_allclose(middle, (0.0, -1.0, 0.5), atol=1e-6)


def test_what_is_missing_is_named_with_where_to_get_it(tmp_path):
    for data_set in DATA_SETS:
        assert data_set.missing(tmp_path)[0].startswith(f"{data_set.title}: no folder")
        assert data_set.licence in data_set.how_to_get()
    (tmp_path / "hope-dataset" / "hope_video" / "scene_0003").mkdir(parents=True)
    (tmp_path / "hope-dataset" / "hope_video" / "scene_0003" / "0000.json").write_text("{}")
    (missing,) = HOPE.missing(tmp_path)
    assert "meshes/eval/*.obj is missing" in missing


def test_bags_of_robots_are_paired_with_odometry_and_truth(tmp_path):
    folder = tmp_path / "kimera_multi" / "campus_outdoor"
    folder.mkdir(parents=True)
    for name in ("acl_jackal", "acl_jackal2", "hathor"):
        (folder / f"10_14_{name}.bag").touch()
        (folder / f"{name}_gt_odom.csv").touch()
    for name in ("acl_jackal2", "hathor"):
        (folder / f"{name}_vio.bag").touch()
    (pair,) = kimera_pairs(tmp_path, QUICK)
    assert [[file.name for file in log.files] for log in pair.logs] == [
        ["10_14_acl_jackal2.bag", "acl_jackal2_vio.bag"],
        ["10_14_hathor.bag", "hathor_vio.bag"],
    ]
    assert [truth.name for truth in pair.truths] == ["acl_jackal2_gt_odom.csv", "hathor_gt_odom.csv"]
    assert not KIMERA_MULTI.missing(tmp_path)


TABLE = Table(
    name="t",
    caption="Two",
    columns=(Column(name="f1", title="F1", more=1), Column(name="error", title="Error", unit="m", more=-1)),
    rows=(
        ("first", (Cell(value=0.5, low=0.4, high=0.6, num=7, paper=0.9), Cell(value=0.2))),
        ("second", (Cell(value=0.75), Cell(value=None, why="refused", paper=0.1))),
    ),
    notes=("a note",),
)


def test_a_table_says_ours_the_papers_and_compares_in_a_scene():
    lines = markdown(TABLE).splitlines()
    assert "| first | 0.500 [0.400, 0.600] (7) / 0.900 | 0.200 |" in lines
    assert "| second | **0.750** | refused / 0.100 |" in lines
    assert "t,second,error,m,,,,,0.1,refused" in as_csv(TABLE).splitlines()
    assert as_json(TABLE)["rows"][0]["num"] == 7
    assert chart(TABLE).image().shape[2] == 3
    with pytest.raises(ValueError, match="1 cells for 2 columns"):
        replace(TABLE, rows=(("short", (Cell(value=1.0),)),))
    rows = tuple((f"{i}", (Cell(value=float(i)), Cell(value=float(i)))) for i in (1, 2, 3, 4))
    lines = markdown(replace(TABLE, rows=rows, groups=(2, 2))).splitlines()
    assert "| 2 | **2.000** | 2.000 |" in lines
    assert "| 3 | 3.000 | **3.000** |" in lines
    assert "| 4 | **4.000** | 4.000 |" in lines
    with pytest.raises(ValueError, match="groups of 3 rows in a table of 4"):
        replace(TABLE, rows=rows, groups=(2, 1))


def test_the_papers_own_means_are_those_of_its_table():
    ours = ALIGNMENT["sq"]
    assert np.mean([metres for _, metres, _ in ours["replica_cad"]]) == pytest.approx(0.0394, abs=1e-4)
    assert np.mean([metres for _, metres, _ in ours["kimera_multi"]]) == pytest.approx(0.2448, abs=1e-4)
    assert max(VIEWS, key=lambda name: VIEWS[name]["hope"][0]) == "s_score"


def test_a_step_is_measured_once_for_each_input(tmp_path):
    told, made = [], iter([{"a": 0.1 + 0.2}, {"a": 7}])
    for log, value in ((1, 0.1 + 0.2), (1, 0.1 + 0.2), (2, 7)):
        step = Workshop(tmp_path, None, told.append).once("step", {"log": log}, lambda: next(made))
        assert step == {"a": value}
    assert told == ["step", "step"]


def test_robots_in_a_street_have_frames_of_their_own():
    base = RecordingConfig(scene="outdoor", seed=4, robots=2)
    frames = [drawn_frame(replace(base, walk_index=i)) for i in (0, 1)]
    assert np.linalg.norm((invert(frames[0]) @ frames[1])[:3, 3]) > 0.5


def test_every_strategy_chooses_among_the_views_of_one_playback(short_log, demo_truth, tmp_path):
    shapes = ShapeConfig()
    view = replace(
        shapes.single_view,
        volume=replace(shapes.single_view.volume, cells=16),
        symmetry=replace(shapes.single_view.symmetry, num_yaws=4, num_offsets=3),
    )
    config = MapperConfig(shapes=replace(shapes, single_view=view))
    trials = try_views(open_source(short_log), load_truth(demo_truth), config, tmp_path / "map")
    found = [trial for trial in trials if trial.scores]
    assert {frozenset(trial.scores) for trial in found} == {frozenset(STRATEGIES)}
    f1 = {s: sum(one.f1_5pct for t in found if (one := t.scores[s]) is not None) for s in STRATEGIES}
    # The first view of an object is rarely the best one.
    assert 0.0 < f1["initial"] < f1[OURS]
    assert all(item.shape is None for item in open_map(tmp_path / "map").snapshot.objects)
