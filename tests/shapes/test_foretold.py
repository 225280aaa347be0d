from dataclasses import replace
import numpy as np
import pytest
import trimesh
from hickory_stream.ports import NoShape, Reconstruction
from hickory_stream.shapes.generated.judgement import by_other_views, newly_seen
from tools.evaluation.shapes.spoiled_generator import plain_mesh, sighted


class Knows:
    """Stands for an embedded reconstructor, and remembers what it was shown."""

    name = "knows"

    def __init__(self, answer):
        self.answer = answer
        self.shown = None

    def reconstruct(self, inputs):
        self.shown = inputs
        return self.answer


@pytest.fixture(scope="module")
def seen():
    """A box that is seen from three sides of an arc."""
    whole = trimesh.creation.box((0.5, 0.3, 0.4)).apply_translation((0, 0, 0.2)).subdivide().subdivide().subdivide()
    return sighted(plain_mesh(np.asarray(whole.vertices), np.asarray(whole.faces)), np.random.default_rng(3), 3)


def placed(seen, *, flattened):
    """Return the truth, with what lies behind the middle of what the first view sees drawn towards that by a share."""
    mesh, crop = seen.mesh_world, seen.made_from.crops[0]
    vertices = mesh.vertices.astype(np.float64)
    along = vertices @ crop.world_from_camera[:3, 2]
    behind = np.maximum(along - np.median(along), 0.0) * flattened
    moved = vertices - behind[:, None] * crop.world_from_camera[:3, 2]
    return Reconstruction(mesh=plain_mesh(moved, mesh.faces), world_from_object=np.eye(4))


def test_a_shape_is_asked_for_what_its_own_views_did_not_show(seen):
    first, new, size_m = newly_seen(seen.made_from, 1)
    assert len(new) > 100
    nearest = np.linalg.norm(new[:, None] - first[None, ::5], axis=2).min(axis=1)
    assert nearest.min() > 0.02 * size_m
    assert newly_seen(seen.made_from, len(seen.made_from.crops)) is None
    assert newly_seen(replace(seen.made_from, crops=seen.made_from.crops[:1] * 3), 1) is None


def test_a_made_up_back_loses_to_a_better_foretelling_shape(seen):
    true, flat = placed(seen, flattened=0.0), placed(seen, flattened=0.9)
    knows = Knows(true)
    refused = by_other_views(flat, seen.made_from, 1, knows)
    assert not refused.is_accepted
    assert "the embedded one 1.00" in refused.reason
    # The embedded shape is asked with the generator's views alone, and with no points that only others saw.
    assert knows.shown.crops == seen.made_from.crops[:1]
    assert len(newly_seen(seen.made_from, 1)[0]) == len(knows.shown.points_world)


@pytest.mark.parametrize("other", ["flat", "none"])
def test_a_shape_that_foretold_what_was_seen_is_kept(seen, other):
    embedded = NoShape(reason="no") if other == "none" else placed(seen, flattened=0.9)
    verdict = by_other_views(placed(seen, flattened=0.0), seen.made_from, 1, Knows(embedded))
    assert verdict.is_accepted
    assert verdict.reason.startswith("foretold 1.00")
