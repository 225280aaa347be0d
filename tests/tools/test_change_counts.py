from pathlib import Path
import numpy as np
import pytest
from hickory_stream.changes.records import Evidence, ObjectChange, Verdict
from hickory_stream.evaluation.truth import Truth, TruthChange, TruthFrame, TruthObject
from hickory_stream.geometry.camera import Camera
from hickory_stream.pictures.raycast import Scene, Surface
from tests.engine.snapshot_fixtures import box_mesh
from tools.benchmarks.maps.change_counts import PairCounts, calibration_figures, count_figures, sum_of
from tools.benchmarks.maps.changes import is_of_person, judged
from tools.benchmarks.maps.within_run import counted
from tools.evaluation.true_changes import TrueChanges

CHANGE_NS = 500


def item(object_id, *frames):
    return TruthObject(
        id=object_id, kind="box", mesh="", world_from_object=np.eye(4), seen_fraction=0.9, frames=frames or (0, 9)
    )


TRUTH = Truth(
    folder=Path(),
    camera=Camera(width=8, height=8, fx=8.0, fy=8.0, cx=4.0, cy=4.0),
    # 1 stays, 2 moves, 3 is gone, 4 is new.
    objects=(item(1), item(2), item(4, 9)),
    structure=(),
    frames=tuple(TruthFrame(index=i, stamp_ns=100 * i, world_from_camera=np.eye(4), instances="") for i in range(10)),
    change=TruthChange(stamp_ns=CHANGE_NS, before=(item(2), item(3, 0))),
)
HELD = ({1: 11, 2: 12, 3: 13}, {1: 11, 2: 22, 4: 24})


@pytest.mark.parametrize(("gone", "moved", "new", "held_found", "moved_as_moved", "false_changes"), [
    ({13}, {12: 22}, {24}, 3, 1, 0),
    ({12, 13}, {}, {22, 24}, 3, 0, 0),
    ({11}, {}, set(), 0, 0, 1),
    ({13}, {11: 22}, set(), 1, 0, 1),
])  # fmt: skip
def test_what_is_said_is_held_against_what_changed(gone, moved, new, held_found, moved_as_moved, false_changes):
    counts = counted(TRUTH, HELD, gone, moved, new)
    assert (counts.changes, counts.held, counts.moved_held, counts.objects) == (3, 3, 1, 1)
    found = (counts.held_found, counts.moved_as_moved, counts.false_changes)
    assert found == (held_found, moved_as_moved, false_changes)


def test_probabilities_are_compared_with_the_rate_of_success():
    nothing = Evidence(free=0.0, structure=0.0, objects=0.0, unseen=0.0, num_clear=0)
    told = [
        ObjectChange(verdict=verdict, id_a=a, id_b=b, probability=probability, evidence=nothing)
        for verdict, a, b, probability in (
            (Verdict.STILL_THERE, 11, 21, 0.9),  # 1 stayed
            (Verdict.STILL_THERE, 12, 21, 0.6),  # 2 is another object than 1
            (Verdict.MOVED, 12, 22, 0.8),
            (Verdict.GONE, 13, None, 0.9),
            (Verdict.GONE, 11, None, 0.9),  # 1 stayed
            (Verdict.NEW, None, 24, 1.0),
            (Verdict.EXCHANGED, 13, 24, 0.7),
            (Verdict.NOT_SEEN_AGAIN, 11, None, 0.5),  # says nothing
            (Verdict.NEW, None, 99, 1.0),  # no true object
        )
    ]
    true = TrueChanges(stayed=(1,), moved=(2,), gone=(3,), new=(4,))
    found = judged(told, true, {11: 1, 12: 2, 13: 3}, {21: 1, 22: 2, 24: 4})
    assert [right for _, right in found] == [True, False, True, True, False, True, True]
    probability, brier = sum(p for p, _ in found), sum((p - right) ** 2 for p, right in found)
    counts = PairCounts(said=7, said_right=5, probability=probability, brier=brier)
    over, brier = calibration_figures(sum_of([counts, PairCounts()]))
    assert over.value == pytest.approx(5.8 / 7 - 5 / 7)
    assert brier.value == pytest.approx((0.01 + 0.36 + 0.04 + 0.01 + 0.81 + 0.0 + 0.09) / 7)
    assert calibration_figures(PairCounts()) == []


def test_what_the_map_lacks_is_printed_beside_what_it_has():
    counts = counted(TRUTH, ({1: 11, 2: 12, 3: None}, {1: 11, 2: None, 4: None}), set(), {}, set())
    assert (counts.changes, counts.held, counts.found, counts.moved_as_moved) == (3, 0, 0, 0)
    both = sum_of([counts, PairCounts(held=4, held_found=3, changes=5, found=3)])
    figures = {figure.name: figure for figure in count_figures(both, "run_")}
    assert figures["run_changes_found_fraction"].value == 0.75
    assert figures["run_changes_found_of_all"].of.startswith("3 of 8 changes")


def test_an_object_of_the_person_is_off_all_surfaces():
    mesh = box_mesh((1.0, 1.0, 1.0), (9, 9, 9))
    scene = Scene([Surface(vertices=mesh.vertices, faces=mesh.faces, colors=mesh.colors, owner=1)])
    figure = np.random.default_rng(0).normal([3.0, 0.0, 1.0], [0.1, 0.1, 0.4], (500, 3)).astype(np.float32)
    assert is_of_person(figure, scene, np.array([[0.0, 5.0], [3.1, 0.0]]))
    assert not is_of_person(figure, scene, np.array([[0.0, 5.0]]))
    assert not is_of_person(mesh.vertices, scene, np.array([[0.0, 0.0]]))
