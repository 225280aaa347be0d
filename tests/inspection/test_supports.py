from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from hickory_stream.inspection import supports
from hickory_stream.inspection.supports import _body, support_text, supports_of
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.rigid_motion import moved_object
from hickory_stream.mapping.rules.support_graph import Relation, Support
from tests.mapping.mapping_fixtures import VOXEL_M, box_surface, drive, keyframe, observation, space

CONFIG = MappingConfig(voxels=Lattice(object_m=VOXEL_M))
PLACE = from_rotation_translation(yaw_rotation(0.7), np.array([4.0, 1.0, 0.2]))


@pytest.fixture
def snapshot():
    """A box on the floor, and a smaller one on it."""
    core = MapperCore(CONFIG)
    boxes = box_surface((0, 0, 0.2), (0.6, 0.6, 0.4)), box_surface((0.1, 0.1, 0.45), (0.1, 0.1, 0.1))
    seen = [observation(i, points) for i, points in enumerate(boxes)]
    drive(core, [keyframe(i, seen, seen=space(floor_z_m=0.0)) for i in range(5)])
    return core.snapshot()


def test_an_object_rests_on_the_floor_and_another_on_it(snapshot):
    found = supports_of(snapshot, CONFIG)
    assert {body: support_text(supports) for body, supports in found.items()} == {1: "the floor", 2: "#1"}
    (on_it,) = (support for support in found[2] if support.relation is Relation.RESTS_ON)
    assert on_it.height_m == pytest.approx(0.4, abs=VOXEL_M)


def test_a_correction_of_the_poses_changes_no_relation(snapshot):
    (submap,) = snapshot.submaps
    moved = replace(
        snapshot,
        submaps=(replace(submap, world_from_submap=PLACE),),
        objects=tuple(moved_object(item, PLACE) for item in snapshot.objects),
    )
    assert {i: support_text(s) for i, s in supports_of(moved, CONFIG).items()} == {1: "the floor", 2: "#1"}


def test_an_object_without_points_has_no_relations(snapshot):
    bare = replace(snapshot.objects[0], points_world=np.empty((0, 3), np.float32), colors=np.empty((0, 3), np.uint8))
    found = supports_of(replace(snapshot, objects=(bare, snapshot.objects[1])), CONFIG)
    assert found[1] == ()
    assert support_text(found[1]) == "-"


@pytest.mark.parametrize(
    ("relation", "by", "text"),
    [
        (Relation.HANGS_FROM, 3, "hangs from #3"),
        (Relation.PART_OF, 3, "is part of #3"),
        (Relation.LEANS_ON, None, "a wall"),
        (Relation.HIDDEN_BY, 3, "-"),
    ],
)
def test_what_holds_an_object_is_told_in_a_few_words(relation, by, text):
    assert support_text((Support(body=1, relation=relation, by=by),)) == text


def test_only_possible_contacts_of_a_submap_are_examined(snapshot, monkeypatch):
    looked_at = []

    def counted(item, config):
        looked_at.append(item.id)
        return _body(item, config)

    (submap,), far = snapshot.submaps, from_rotation_translation(np.eye(3), np.array([40.0, 0.0, 0.0]))
    there = tuple(replace(moved_object(item, far), id=item.id + 10, submap_id=1) for item in snapshot.objects)
    both = replace(snapshot, submaps=(submap, replace(submap, id=1)), objects=(*snapshot.objects, *there))
    monkeypatch.setattr(supports, "_body", counted)
    found = supports_of(both, CONFIG)
    assert looked_at == [1, 2, 11, 12]
    assert {i: support_text(s) for i, s in found.items()} == {1: "the floor", 2: "#1", 11: "the floor", 12: "#11"}
