import json
import numpy as np
import pytest
from hickory_stream.errors import InputError, RecordingError
from tools.benchmarks.common.cached_runs import cached
from tools.benchmarks.common.intervals import bootstrap, wilson
from tools.benchmarks.foreign.figures import figures_of, of_map, reasons
from tools.benchmarks.foreign.gate import own_seeds
from tools.benchmarks.foreign.logs import foreign_log, worlds_folder
from tools.benchmarks.foreign.parts import OUTDOORS, OWN, WORLDS, Part, all_parts, chosen_parts


def record(found, objects, sizes=None):
    """What a map has: which true objects are found, and (right, ignored) of its objects."""
    return {
        "truth": [
            {"id": i, "size_m": (sizes or [1.0] * len(found))[i], "found_25": is_found, "found_50": False}
            | {"is_reachable": i != 1, "is_fixture": is_found and i == 0, "num_seen": 10, "nearest_m": 4.0 + 2.0 * i}
            | {"f1_5pct": 0.8 * is_found, "adds_10": is_found, "tracks": int(is_found)}
            | {"invented_m3": 0.1 * i if is_found else None, "true_m3": 1.0 if is_found else None}
            | {"contained": 0.9 if is_found else None, "missed_because": None if is_found else "taken for structure"}
            for i, is_found in enumerate(found)
        ],
        "objects": [
            {"id": i, "size_m": 1.0, "right_25": right, "right_50": False, "ignored": ignored}
            | {"is_structure": False, "surface_m2": 2.0, "generated_m2": 1.0 * right}
            | {"false_because": None if right or ignored else "structure"}
            for i, (right, ignored) in enumerate(objects)
        ],
        "little_seen": 5,
    }


def by_name(figures):
    return {figure.name: figure for figure in figures}


def by_hand(world, rung="ours", walk="A", camera="hand"):
    return Part(world=world, walk=walk, camera=camera, rung=rung)


def test_the_campus_has_near_things_and_pieces_of_structure():
    parts = [part for part in all_parts() if part.world == "campus"]
    found = by_name(figures_of({part: record([True, False], [(True, False), (False, False)]) for part in parts}))
    assert (found["campus_recall_25"].value, found["campus_near_recall_25"].value) == (0.5, 1.0)
    assert found["campus_ground_pieces"].value == found["campus_B_robot_ground_pieces"].value == 1
    assert "campus_A_hand_recall_25" in found


def test_a_figure_has_denominator_interval_and_exclusions():
    found = by_name(figures_of({by_hand("home"): record([True, True, False, False], [(True, False)] * 2)}))
    recall = found["home_recall_25"]
    assert (recall.value, recall.of, recall.role) == (0.5, "2 of 4 true objects", "tuned on")
    assert recall.left_out == "5 true objects of which under 30 % was seen"
    assert recall.interval == pytest.approx((0.150, 0.850), abs=0.001)
    assert recall.interval_by == "Wilson"
    office = by_name(figures_of({by_hand("office"): record([True], [(True, False)])}))
    assert office["office_recall_25"].role == "reported"


def test_little_seen_truth_and_small_and_large_things_count():
    # Right, right although of ignored truth, wrong, ignored.
    objects = [(True, False), (True, True), (False, False), (False, True)]
    precision = by_name(of_map("home", record([True, True], objects), ""))["home_precision_25"]
    assert precision.of == "2 of 3 objects"
    assert precision.left_out.startswith("1 objects")
    found = by_name(of_map("home", record([True, True, False], [], [0.1, 0.5, 0.6]), ""))
    assert found["home_small_recall_25"].of == "1 of 1 true objects"
    assert found["home_large_recall_25"].of == "1 of 2 true objects"
    assert "home_precision_25" not in found, "a map without objects has no precision"


def test_reach_fixtures_and_inventions_have_figures_of_their_own():
    home = record([True, True, False], [(True, False), (False, False), (False, False)])
    home["objects"][2] |= {"is_structure": True}
    home["truth"][0] |= {"found_50": True}
    found = by_name(of_map("home", home, ""))
    assert (found["home_recall_25"].of, found["home_recall_50"].of) == ("2 of 3 true objects", "1 of 3 true objects")
    assert found["home_reachable_recall_25"].of == found["home_reachable_recall_50"].of == "1 of 2 true objects"
    assert found["home_reachable_recall_25"].left_out.endswith("1 with depth in fewer than three keyframes")
    assert found["home_fixture_share"].of == "1 of 2 true objects found"
    assert found["home_precision_25"].of == "1 of 2 objects"
    assert found["home_precision_25"].left_out.endswith("1 fixtures on structure")
    assert (found["home_generated_share"].value, found["home_invented_volume"].value) == pytest.approx((1 / 6, 0.05))


def test_ladder_robots_and_surfaces_are_means_of_all_worlds():
    measured = {by_hand(world): record([True, False], []) for world in WORLDS}
    measured |= {by_hand(world, "masks"): record([True, world == "home"], []) for world in WORLDS}
    found = by_name(figures_of(measured))
    assert found["ladder_gap_masks"].value == pytest.approx(0.5 / 4)
    assert found["home_true_masks_recall_25"].value == 1.0
    assert "ladder_gap_joins" not in found
    del measured[by_hand("warehouse", "masks")]
    assert "ladder_gap_masks" not in by_name(figures_of(measured))
    measured = {by_hand(world): record([True, True], []) for world in WORLDS}
    measured |= {by_hand(world, camera="robot"): record([True, False, True, True], []) for world in WORLDS}
    assert by_name(figures_of(measured))["robot_recall_25_loss"].value == pytest.approx(0.25)
    measured = {by_hand(world): record([True, False], []) for world in WORLDS}
    found = by_name(figures_of(measured))
    assert found["foreign_f1_5pct"].value == pytest.approx(0.4)
    assert (found["foreign_adds_10"].value, found["foreign_tracks_per_object"].value) == (0.5, 1.0)
    assert found["foreign_containment"].value == pytest.approx(0.9)
    assert found["things_found_50_over_25"].of == "0 of 4 true objects found"
    assert found["foreign_invented_volume"].value == 0.0
    del measured[by_hand("office")]
    assert "foreign_f1_5pct" not in by_name(figures_of(measured))


def test_own_worlds_and_streets_are_pooled_with_their_ground():
    measured = {Part(world=name): record([True, i > 0], []) for i, name in enumerate(OWN)}
    assert by_name(figures_of(measured))["own_recall_25"].of == "5 of 6 true objects"
    measured = {
        Part(world=name): record([True, i > 0], [(True, False), (False, False)]) for i, name in enumerate(OUTDOORS)
    }
    found = by_name(figures_of(measured))
    assert found["outdoor_recall_25"].of == "3 of 4 true objects"
    assert found["outdoor_precision_25"].of == "2 of 4 objects"
    assert (found["outdoor_ground_objects"].value, found["outdoor_ground_objects"].better) == (2, "lower")
    assert "outdoor_ground_objects" not in by_name(figures_of({by_hand("home"): record([True], [])}))


def test_masks_of_clouds_are_counted_and_the_segmenter_is_named():
    clouds = [
        {"name": "a", "small": 1, "labelled": 4, "things": 3, "masks": 3, "right": 3},
        {"name": "b", "small": 0, "labelled": 3, "things": 3, "masks": 1, "right": 1},
    ]
    found = by_name(figures_of({Part(world="clouds_report"): {"clouds": clouds}}))["clouds_report_f1_50"]
    assert found.value == pytest.approx(0.8)
    assert (found.role, found.left_out) == ("reported", "1 things under 0.2 % of their image")
    speed = {"segmenter": "geometric", "segmenter_ms": 30.0, "keyframe_ms": 70.0, "keyframes": 20, "weights_mb": 0.1}
    found = by_name(figures_of({Part(world="speed"): speed}))
    assert (found["segmenter"].value, found["keyframe_ms"].value, found["weights_mb"].value) == ("geometric", 70.0, 0.1)


COUNTS = {
    "home": 8, "office:A": 6, "office:A:hand:ours": 1, "home:masks,warehouse:masks": 2, "clouds": 2, "own": 3,
    "outdoor": 2, "outdoor2": 1, "kitchen": 1, "robot": 0, "home:C": 0,
}  # fmt: skip


@pytest.mark.parametrize("only", COUNTS)
def test_parts_are_named_by_world_walk_camera_and_rung(only):
    if COUNTS[only]:
        assert len(chosen_parts([only])) == COUNTS[only]
    else:
        with pytest.raises(InputError, match="no such part"):
            chosen_parts([only])


def test_everything_is_measured_once_with_fresh_or_given_seeds():
    parts = chosen_parts([])
    assert parts == all_parts()
    assert len(parts) == len({part.name for part in parts}) == 4 * 8 + 4 + 9
    seeds = own_seeds(0, "0" * 63 + "1"), own_seeds(0, "ff" * 32), own_seeds(2, "0" * 64)
    assert len({seed for three in seeds for seed in three}) == 9
    assert own_seeds(2, "f" * 64) == seeds[2]
    assert min(seed for three in seeds for seed in three) >= 100_000


def test_a_cached_part_is_measured_again_only_when_damaged(tmp_path):
    file, runs = tmp_path / "foreign" / "home.json", iter(range(3))
    assert [cached(file, lambda: {"run": next(runs)}) for _ in range(2)] == [{"run": 0}] * 2
    file.write_text('{"run"')
    assert cached(file, lambda: {"run": next(runs)}) == {"run": 1}
    assert cached(tmp_path / "office.json", lambda: {"run": next(runs)}) == {"run": 2}
    assert {path.name for path in tmp_path.rglob("*.*")} == {"home.json", "office.json"}


def test_a_folder_without_worlds_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("HICKORY_WORLDS", str(tmp_path))
    with pytest.raises(RecordingError, match="--worlds or HICKORY_WORLDS"):
        worlds_folder(None)


_PROGRAM = """
import pathlib, sys
world, out = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
if (world / "broken").exists():
    sys.exit("the walk comes too close to something")
(out / "truth").mkdir()
(out / "truth" / "truth.json").write_text("{}")
(out / "log.mcap").write_text(" ".join(sys.argv[3:]))
(out / "truth" / "world.json").write_text((world / "world.json").read_text())
with (world / "runs").open("a") as runs:
    runs.write("1")
"""


@pytest.fixture
def worlds(tmp_path, monkeypatch):
    """A folder of worlds whose program writes its arguments for a log."""
    monkeypatch.setenv("HICKORY_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "worlds"
    for name in ("home", "service-office"):
        (folder / name).mkdir(parents=True)
        (folder / name / "world.json").write_text("{}")
    (folder / "make_world_log.py").write_text(_PROGRAM)
    return folder


def test_a_log_is_rendered_once_per_world_unless_that_fails(worlds, tmp_path):
    first = foreign_log(worlds, "office", "B", "robot")
    assert first.log.read_text() == "--trajectory B --seconds 60 --hz 5 --camera-height 0.45"
    assert foreign_log(worlds, "office", "B", "robot") == first
    assert (worlds / "service-office" / "runs").read_text() == "1"
    (worlds / "service-office" / "world.json").write_text('{"objects": []}')
    assert foreign_log(worlds, "office", "B", "robot").key != first.key
    assert (worlds / "service-office" / "runs").read_text() == "11"
    kept = {path for path in (tmp_path / "cache").rglob("*") if path.is_file()}
    (worlds / "home" / "broken").touch()
    with pytest.raises(RecordingError, match="too close to something"):
        foreign_log(worlds, "home", "A", "hand")
    assert {path for path in (tmp_path / "cache").rglob("*") if path.is_file()} == kept
    with pytest.raises(RecordingError, match="bookstore is no world"):
        foreign_log(worlds, "bookstore", "A", "hand")


def test_a_walk_back_has_the_places_of_the_walk(worlds):
    points = [[0, 0], [1, 0], [1, 2], [0, 2]]
    (worlds / "home" / "world.json").write_text(json.dumps({"walks": {"A": {"points": points, "sway_deg": 5}}}))
    back = json.loads((foreign_log(worlds, "home", "A-back", "robot").truth / "world.json").read_text())["walks"]
    assert back["A-back"] == {"points": [[0, 0], [0, 2], [1, 2], [1, 0]], "sway_deg": 5}
    assert back["A"]["points"] == points


def test_intervals_are_wilsons_or_a_repeatable_bootstrap():
    # Newcombe (1998), table I: 81 of 263, and 0 of 20.
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    rows = np.random.default_rng(1).normal(3.0, 1.0, 400)
    low, high = bootstrap([rows], lambda groups: float(groups[0].mean()))
    # The standard error of the mean of 400 is a twentieth of sigma.
    assert high - low == pytest.approx(2 * 1.96 * rows.std() / 20, rel=0.1)
    assert low < rows.mean() < high
    assert (low, high) == bootstrap([rows], lambda groups: float(groups[0].mean()))


def test_losses_to_structure_are_counted_over_all_worlds():
    one, other = record([True, False], [(True, False), (False, False)]), record([True], [(True, False), (False, True)])
    other["truth"].append(other["truth"][0] | {"found_25": False, "missed_because": "in pieces"})
    found = by_name(figures_of({by_hand(world): one if world == "home" else other for world in WORLDS}))
    swallowed, phantoms = found["foreign_structure_swallowed"], found["foreign_structure_phantoms"]
    assert (swallowed.of, swallowed.better) == ("1 of 8 true objects", "lower")
    assert (phantoms.of, phantoms.better) == ("1 of 5 objects", "lower")
    assert reasons(one) == ["1 missed: 1 taken for structure", "1 false: 1 structure"]
    assert "foreign_structure_swallowed" not in by_name(figures_of({by_hand("home"): one}))
