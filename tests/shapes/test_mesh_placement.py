from dataclasses import replace
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from hickory_stream.geometry.rigid import apply
from hickory_stream.ports import MeshPlacement, NoShape, NotPlaced, Reconstruction
from hickory_stream.shapes.generated import judgement
from hickory_stream.shapes.generated.distance_field import distance_field, even_samples, field_at
from hickory_stream.shapes.generated.placement import EmbeddedPlacement, PlacementConfig
from tools.evaluation.shapes.spoiled_generator import generated, plain_mesh, sighted

CONFIG = PlacementConfig(rotations=300, descents=24, finalists=4)


def hooked():
    """Return a body without any symmetry, that stands on z = 0."""
    parts = [
        trimesh.creation.box((0.5, 0.3, 0.1)).apply_translation((0, 0, 0.05)),
        trimesh.creation.box((0.1, 0.1, 0.5)).apply_translation((0.2, 0.1, 0.35)),
        trimesh.creation.box((0.25, 0.1, 0.1)).apply_translation((0.05, 0.1, 0.5)),
    ]
    whole = trimesh.util.concatenate(parts).subdivide().subdivide()
    return plain_mesh(np.asarray(whole.vertices), np.asarray(whole.faces))


def box(size):
    whole = trimesh.creation.box(size).apply_translation((0, 0, size[2] / 2)).subdivide().subdivide().subdivide()
    return plain_mesh(np.asarray(whole.vertices), np.asarray(whole.faces))


@pytest.fixture(scope="module")
def seen():
    return sighted(hooked(), np.random.default_rng(4), 3)


def adds(seen, given, placement):
    """Return ADD-S as a share of the size, of the truth as oracle and placement carry it."""
    true, _ = even_samples(seen.mesh_world.vertices, seen.mesh_world.faces, 1500)
    moved = apply(placement.world_from_mesh @ given.mesh_from_true, true)
    return float(cKDTree(moved).query(true)[0].mean() / np.linalg.norm(np.ptp(true, axis=0)))


def placed(given, inputs):
    found = EmbeddedPlacement(CONFIG).place(given.mesh, inputs)
    assert isinstance(found, MeshPlacement), found
    return found


@pytest.mark.parametrize(("seed", "is_spoiled"), [(0, False), (1, False), (2, True)])
def test_a_mesh_in_its_own_frame_and_scale_is_put_on_the_object(seen, seed, is_spoiled):
    given = generated(seen, np.random.default_rng(seed), is_spoiled=is_spoiled)
    found = placed(given, seen.made_from)
    assert adds(seen, given, found) < (0.05 if is_spoiled else 0.02)
    scale = np.cbrt(np.linalg.det((found.world_from_mesh @ given.mesh_from_true)[:3, :3]))
    assert scale == pytest.approx(1, abs=0.1 if is_spoiled else 0.04)
    assert 0 < found.sigma_m < 0.1
    assert not found.is_symmetric


def test_the_same_inputs_give_the_same_bits(seen):
    given = generated(seen, np.random.default_rng(0), is_spoiled=False)
    first, second = placed(given, seen.made_from), placed(given, seen.made_from)
    assert first.world_from_mesh.tobytes() == second.world_from_mesh.tobytes()


def test_a_stretch_is_found_within_its_bounds_and_told():
    seen = sighted(hooked(), np.random.default_rng(6), 5)
    given = generated(seen, np.random.default_rng(0), is_spoiled=False)
    long = given.mesh.vertices.astype(np.float64) @ own_axes(given.mesh)
    stretched = plain_mesh(long * np.array([1.0, 1.0, 1.25]), given.mesh.faces)
    found = EmbeddedPlacement(CONFIG).place(stretched, seen.made_from)
    assert found.stretch.prod() == pytest.approx(1)
    assert 1.12 < found.stretch.max() / found.stretch.min() < 1.4
    rigid = EmbeddedPlacement(replace(CONFIG, most_stretch=1.0)).place(stretched, seen.made_from)
    assert np.ptp(rigid.stretch) < 1e-9


def own_axes(mesh):
    """Return (3, 3) right-handed columns, the principal axes of a mesh."""
    samples, _ = even_samples(mesh.vertices, mesh.faces, 5000)
    axes = np.linalg.eigh(np.cov(samples.T))[1]
    return axes * np.sign(np.linalg.det(axes))


def test_what_fits_as_well_when_it_is_turned_is_called_symmetric():
    seen = sighted(box((0.4, 0.3, 0.5)), np.random.default_rng(1), 4)
    given = generated(seen, np.random.default_rng(1), is_spoiled=False)
    found = placed(given, seen.made_from)
    assert adds(seen, given, found) < 0.02
    assert found.is_symmetric


def test_what_was_not_seen_or_is_no_surface_is_not_placed(seen):
    nothing = replace(
        seen.made_from, crops=(), points_world=np.zeros((0, 3), np.float32), colors=np.zeros((0, 3), np.uint8)
    )
    assert isinstance(EmbeddedPlacement(CONFIG).place(seen.mesh_world, nothing), NotPlaced)
    flat = plain_mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    assert "area" in EmbeddedPlacement(CONFIG).place(flat, seen.made_from).reason


def test_distances_are_those_to_the_surface():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    field = distance_field(np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.int32), 40)
    points = np.random.default_rng(0).normal(size=(200, 3))
    found = np.array([field_at(field.distance, field.origin, field.cell, *point) for point in points])
    true = np.abs(np.linalg.norm(points, axis=1) - 1)
    is_on_grid = np.abs(points).max(axis=1) < 1.1
    assert np.abs(found - true)[is_on_grid].max() < field.cell
    # Beyond the grid the way to its border is added, which is never shorter than the straight one.
    assert (found > true - field.cell).all()


def evidence_of(mesh, seen):
    return judgement.shape_evidence(Reconstruction(mesh=mesh, world_from_object=np.eye(4)), seen.made_from, 1)


def test_the_truth_is_accepted_and_other_things_are_refused(seen):
    truth = evidence_of(seen.mesh_world, seen)
    assert truth.explained > 0.9
    assert truth.violated < 0.1
    assert judgement.judged(truth).is_accepted
    low, high = seen.mesh_world.vertices.min(axis=0), seen.mesh_world.vertices.max(axis=0)
    filled = trimesh.creation.box(high - low).apply_translation((low + high) / 2).subdivide().subdivide()
    block = evidence_of(plain_mesh(np.asarray(filled.vertices), np.asarray(filled.faces)), seen)
    verdict = judgement.judged(block)
    assert not verdict.is_accepted
    assert "in free space" in verdict.reason
    above = plain_mesh(seen.mesh_world.vertices + np.array([0, 0, 0.2]), seen.mesh_world.faces)
    assert "off its support" in judgement.judged(evidence_of(above, seen)).reason


def test_a_shape_worth_less_does_not_replace_the_embedded():
    good = judgement.ShapeEvidence(
        explained=0.9, violated=0.05, silhouette=0.9, other_silhouette=None, support_gap=None
    )
    poor = replace(good, explained=0.7)
    assert judgement.replaces(good, poor, judgement.JudgementConfig()).is_accepted
    assert judgement.replaces(good, good, judgement.JudgementConfig()).is_accepted
    refused = judgement.replaces(poor, good, judgement.JudgementConfig())
    assert not refused.is_accepted
    assert "worth 0.65, the embedded one 0.85" in refused.reason


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
def seen_box():
    """A box, seen from three sides of an arc."""
    whole = trimesh.creation.box((0.5, 0.3, 0.4)).apply_translation((0, 0, 0.2)).subdivide().subdivide().subdivide()
    return sighted(plain_mesh(np.asarray(whole.vertices), np.asarray(whole.faces)), np.random.default_rng(3), 3)


def drawn(seen_box, *, flattened):
    """Return the truth, with what lies behind the middle of what the first view sees drawn towards it by a share."""
    mesh, crop = seen_box.mesh_world, seen_box.made_from.crops[0]
    vertices = mesh.vertices.astype(np.float64)
    along = vertices @ crop.world_from_camera[:3, 2]
    behind = np.maximum(along - np.median(along), 0.0) * flattened
    moved = vertices - behind[:, None] * crop.world_from_camera[:3, 2]
    return Reconstruction(mesh=plain_mesh(moved, mesh.faces), world_from_object=np.eye(4))


def test_a_shape_is_asked_for_what_its_own_views_did_not_show(seen_box):
    first, new, size_m = judgement.newly_seen(seen_box.made_from, 1)
    assert len(new) > 100
    nearest = np.linalg.norm(new[:, None] - first[None, ::5], axis=2).min(axis=1)
    assert nearest.min() > 0.02 * size_m
    assert judgement.newly_seen(seen_box.made_from, len(seen_box.made_from.crops)) is None
    assert judgement.newly_seen(replace(seen_box.made_from, crops=seen_box.made_from.crops[:1] * 3), 1) is None


def test_a_made_up_back_loses_to_a_better_foretelling_shape(seen_box):
    true, flat = drawn(seen_box, flattened=0.0), drawn(seen_box, flattened=0.9)
    knows = Knows(true)
    refused = judgement.by_other_views(flat, seen_box.made_from, 1, knows)
    assert not refused.is_accepted
    assert "the embedded one 1.00" in refused.reason
    # The embedded shape is asked with the generator's views alone, and with no points that only others saw.
    assert knows.shown.crops == seen_box.made_from.crops[:1]
    assert len(judgement.newly_seen(seen_box.made_from, 1)[0]) == len(knows.shown.points_world)


@pytest.mark.parametrize("other", ["flat", "none"])
def test_a_shape_that_foretold_what_was_seen_is_kept(seen_box, other):
    embedded = NoShape(reason="no") if other == "none" else drawn(seen_box, flattened=0.9)
    verdict = judgement.by_other_views(drawn(seen_box, flattened=0.0), seen_box.made_from, 1, Knows(embedded))
    assert verdict.is_accepted
    assert verdict.reason.startswith("foretold 1.00")
