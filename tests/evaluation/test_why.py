from collections import Counter
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.evaluation.false_origins import FALSE_ORIGINS, origin_of
from hickory_stream.evaluation.miss_reasons import MISS_REASONS, Evidence, extents_text, state_of, why_missed
from hickory_stream.evaluation.overlap import Overlap
from hickory_stream.evaluation.truth import Truth, TruthObject
from hickory_stream.evaluation.truth_sightings import Other, Part, Sighting, TruthSightings
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.mesh import write_glb
from hickory_stream.inspection.track_history import stretches_of
from hickory_stream.map_folder.history.track_histories import TrackHistories
from hickory_stream.records import Decision, MapSnapshot
from tests.engine.snapshot_fixtures import box_mesh, make_object, placed

SIDE = 0.4
THING, OTHER, FLOOR = 1, 2, None
CONFIRM_S = 1.75


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    """A cube at the origin, another one 2 m beside it, and a floor 1 m below them."""
    folder = tmp_path_factory.mktemp("truth")
    write_glb(box_mesh((SIDE, SIDE, SIDE), (90, 120, 90)), folder / "cube.glb")
    floor = box_mesh((8.0, 8.0, 0.02), (99, 99, 99))
    write_glb(replace(floor, vertices=floor.vertices - np.float32([0, 0, 1])), folder / "floor.glb")
    objects = tuple(
        TruthObject(
            id=i, kind=kind, mesh="cube.glb", world_from_object=placed(x, 0.0, 0.0), seen_fraction=0.5, frames=(0,)
        )
        for i, kind, x in ((THING, "crate", 0.0), (OTHER, "stove", 2.0))
    )
    camera = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
    return Truth(folder=folder, camera=camera, objects=objects, structure=("floor.glb",), frames=())


def cube(object_id, x, size=(SIDE, SIDE, SIDE), z=0.0):
    return make_object(object_id, box_mesh(size, (90, 120, 90)), placed(x, 0.0, z))


def mask(share, purity, track_id=7, other=OTHER):
    others = () if purity == 1.0 else (Other(truth_id=other, share=1.0 - purity),)
    return Part(where="mask", share=share, observation_index=0, track_id=track_id, purity=purity, others=others)


def sighting(frame, *parts, num_px=500):
    return Sighting(frame=frame, keyframe=frame, stamp_ns=frame, num_px=num_px, distance_m=2.5, parts=parts)


def evidence(truth, sightings, *, objects=(), decisions=(), num_depth=3):
    """What a run saw of the crate; each of its masks went to the track that it names, then came the decisions."""
    book = TrackHistories()
    seen = set()
    for item in sightings:
        for part in item.parts:
            if part.track_id is not None:
                kind = "associate" if part.track_id in seen else "create"
                seen.add(part.track_id)
                went = Decision(kind=kind, object_id=part.track_id, text="mask: new", observation_index=0)
                book.add(item.frame, [went])
    book.add(90, decisions)
    snapshot = MapSnapshot(revision=1, stamp_ns=0, submaps=(), objects=objects)
    return Evidence(
        names={THING: "1 crate", OTHER: "2 stove"},
        sightings=TruthSightings(
            of_object={THING: tuple(sightings), OTHER: ()}, histories=book, num_keyframes=20, smallest_mask_px=100.0,
            masks_of={7: {THING: 300, FLOOR: 700}}, depth_on=Counter({THING: num_depth}),
        ),
        overlap=Overlap(snapshot, truth), boxes={o.id: o.box for o in objects}, confirm_s=CONFIRM_S,
    )  # fmt: skip


def five(*parts):
    return [sighting(frame, *parts) for frame in range(5)]


def drop(cause, text):
    return Decision(kind="drop", object_id=7, text=text, cause=cause)


CASES = {
    "too small in the image": (
        [sighting(frame, mask(1.0, 1.0), num_px=40) for frame in range(6)],
        (),
        "98 % of the masks have 100 pixels and more, it has that in 0 of 6 keyframes, at most 40",
    ),
    "no depth": (five(Part(where="no depth", share=0.9)), (), "5 without depth"),
    "taken for structure": (
        five(Part(where="structure", share=0.8)),
        (),
        "there 80% of its pixels are taken for floor",
    ),
    "in no mask": (five(Part(where="no mask", share=0.8)), (), "5 in no mask"),
    "mask rejected": (five(Part(where="rejected mask", share=0.8, reason="3 points")), (), "most often: 3 points"),
    "one mask with another": (five(mask(0.9, 0.2)), (), "with 2 stove (5); most of these masks went to #7"),
    "merged with another": (five(mask(0.9, 0.9)), (), "5 of its 5 masks went to #7, which is in the map"),
    "in pieces": (five(mask(0.4, 1.0), mask(0.3, 1.0, 8)), (), "2 masks in the median"),
    "too few sightings": (
        five(mask(0.9, 0.9)),
        (drop("never confirmed", "never confirmed, after 3 sightings"),),
        "#7, dropped in frame 90: never confirmed, after 3 sightings; a track takes 1.75 s of "
        "observation, of which a pause adds at most 1 s",
    ),
    "dropped as structure": (
        five(mask(0.9, 0.9)),
        (drop("structure", "[2.1 2.2 0.1] m: structure, after 5 sightings"),),
        "#7, dropped in frame 90: [2.1 2.2 0.1] m: structure",
    ),
    "looked through": (
        five(mask(0.9, 0.9)),
        (drop("looked through", "looked through, after 5 sightings"),),
        "#7, dropped in frame 90: looked through",
    ),
}


@pytest.mark.parametrize("reason", CASES)
def test_a_missed_thing_has_the_reason_of_most_keyframes(truth, reason):
    sightings, decisions, told = CASES[reason]
    missed = why_missed(THING, (), evidence(truth, sightings, decisions=decisions))
    assert (missed.reason, missed.kind) == (reason, "1 crate")
    assert told in missed.text


def test_every_reason_is_listed_and_only_boxes_need_an_object():
    assert set(CASES) | {"box is off", "out of reach"} == set(MISS_REASONS)


def test_a_thing_without_depth_in_three_keyframes_is_out_of_reach(truth):
    unseen = why_missed(THING, (), evidence(truth, [], num_depth=0))
    assert (unseen.reason, unseen.text) == ("out of reach", "none of 20 keyframes shows it")
    missed = why_missed(THING, (7,), evidence(truth, five(mask(0.9, 1.0)), objects=(cube(7, 0.3),), num_depth=2))
    assert (missed.reason, missed.map_ids) == ("out of reach", (7,))
    assert "(of 640 x 480): 2; 5 keyframes show it: 5 in a mask of its own" in missed.text


def test_a_single_object_says_which_extents_differ(truth):
    found = evidence(truth, five(mask(0.9, 1.0)), objects=(cube(7, 0.0, (SIDE, SIDE, 0.02), z=0.19),))
    missed = why_missed(THING, (7,), found)
    assert (missed.reason, missed.map_ids) == ("box is off", (7,))
    assert (
        "#7 has a box IoU of only 0.07: height 0.04 m, true 0.40 m; its middle is off by 0.19 m in height"
        in missed.text
    )
    assert missed.text.endswith("its points are 100% 1 crate")


def test_several_objects_on_a_thing_are_its_pieces(truth):
    halves = (cube(7, -0.1, (0.2, SIDE, SIDE)), cube(8, 0.1, (0.2, SIDE, SIDE)))
    missed = why_missed(THING, (7, 8), evidence(truth, five(mask(0.9, 1.0)), objects=halves))
    assert (missed.reason, missed.map_ids) == ("in pieces", (7, 8))
    assert "#7 has " in missed.text
    assert "#8 has " in missed.text


@pytest.mark.parametrize(("purity", "reason"), [(0.2, "one mask with another"), (0.9, "merged with another")])
def test_a_merged_thing_is_one_by_masks_or_by_tracks(truth, purity, reason):
    merged = (Decision(kind="merge", object_id=9, text="#7 is the same: seen as one", other_id=7),)
    both = cube(9, 1.0, (2.0 + SIDE, SIDE, SIDE))
    found = evidence(truth, five(mask(0.9, purity)), objects=(both,), decisions=merged)
    missed = why_missed(THING, (), found)
    assert (missed.reason, missed.map_ids) == (reason, (9,))
    assert "of what was seen of it is in #9" in missed.text
    if reason == "merged with another":
        assert "its track #7 was merged in frame 90: seen as one" in missed.text


def test_three_sightings_can_be_enough(truth):
    rejected = [sighting(i, Part(where="rejected mask", share=0.8, reason="3 points")) for i in range(3)]
    assert why_missed(THING, (), evidence(truth, rejected)).reason == "mask rejected"


@pytest.mark.parametrize(("parts", "state"), [
    ((mask(0.6, 0.5), Part(where="structure", share=0.4)), "in a mask of its own"),
    ((mask(0.6, 0.4), Part(where="structure", share=0.4)), "in one mask with another"),
    ((mask(0.4, 0.9), mask(0.3, 0.9), Part(where="structure", share=0.3)), "in pieces"),
    ((Part(where="structure", share=0.6), mask(0.4, 0.9)), "taken for structure"),
    ((mask(0.4, 0.9), Part(where="structure", share=0.3)), "in a mask of its own"),
    ((Part(where="no depth", share=0.6),), "without depth"),
])  # fmt: skip
def test_a_keyframe_labels_a_thing_by_most_of_its_pixels(parts, state):
    assert state_of(sighting(0, *parts)) == state


@pytest.mark.parametrize(("size", "shift", "told"), [
    ((0.4, 0.2, 0.3), (0, 0, 0), "no extent by more than a tenth: it is turned, or thin"),
    ((0.8, 0.2, 0.3), (0, 0, 0), "length 0.80 m, true 0.40 m"),
    ((0.4, 0.1, 0.3), (0, 0.05, 0), "width 0.10 m, true 0.20 m; its middle is off by 0.05 m in width"),
    ((0.4, 0.2, 0.1), (0, 0, -0.1), "height 0.10 m, true 0.30 m; its middle is off by 0.10 m in height"),
])  # fmt: skip
def test_extents_are_named_by_the_true_box(size, shift, told):
    def box(sides, center):
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array(sides) / 2
        turned = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
        return gravity_aligned_box(((corners + center) @ turned.T).astype(np.float32), 0.001)

    assert extents_text(box((0.4, 0.2, 0.3), (0, 0, 0)), box(size, shift)) == told


def slab(object_id):
    return cube(object_id, 0.0, (1.0, 1.0, 0.02), z=-1.0)


@pytest.mark.parametrize(
    ("tracked", "owner", "beside", "origin", "told"),
    [
        (cube(7, -0.1, (0.2, SIDE, SIDE)), THING, (7, 8), "a piece of an object", "of 1 crate, which #8 lies on, too"),
        (cube(7, 0.0, (SIDE, SIDE, 0.08), z=0.16), THING, (7,), "an object whose box is off", "IoU 0.20 with 1 crate"),
        (slab(7), None, (), "structure", "100% structure"),
        (cube(7, 5.0), None, (), "nothing there", "100% nothing that the truth has"),
    ],
)
def test_a_false_object_comes_from_what_its_points_are(truth, tracked, owner, beside, origin, told):
    found = evidence(truth, five(mask(0.9, 0.9)), objects=(tracked,))
    false = origin_of(7, owner, {THING: beside}, found)
    assert false.origin == origin
    assert told in false.text
    assert "made in frame 0 (mask) of masks in 5 keyframes; its masks show 70% no object, 30% 1 crate" in false.text


def test_an_object_of_two_things_is_neither(truth):
    parts = [cube(1, x, (SIDE, SIDE, SIDE)) for x in (0.0, 2.0)]
    points = np.concatenate([part.points_world for part in parts])
    both = replace(
        parts[0], id=7, points_world=points, colors=np.concatenate([part.colors for part in parts]),
        box=gravity_aligned_box(points, 0.01),
    )  # fmt: skip
    false = origin_of(7, None, {}, evidence(truth, five(mask(0.9, 0.9)), objects=(both,)))
    assert (false.origin, false.truth_ids) == ("several things in one", (THING, OTHER))
    assert set(FALSE_ORIGINS) >= {false.origin}


def test_consecutive_equal_frames_are_one_stretch():
    told = [(0, "a"), (2, "a"), (4, "b"), (6, "a")]
    found = [(s.first_frame, s.last_frame, s.num_keyframes, s.text) for s in stretches_of(told)]
    assert found == [(0, 2, 2, "a"), (4, 4, 1, "b"), (6, 6, 1, "a")]


def test_a_thing_counts_as_held_only_where_points_are_its_own(truth, tmp_path):
    overlap = Overlap(MapSnapshot(revision=1, stamp_ns=0, submaps=(), objects=(cube(3, 2.0),)), truth)
    assert overlap.covered(OTHER)[3] > 0.9
    assert overlap.covered(THING) == {}
    assert overlap.lies_on[3].largest() == (OTHER, 1.0)
