import dataclasses
import inspect
import json
from dataclasses import FrozenInstanceError, fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
import numpy as np
import pytest
from hickory_stream import events, ports, records
from hickory_stream.geometry import boxes, mesh, superquadric
from hickory_stream.geometry.camera import Camera
from hickory_stream.journal.record_codec import record_classes
from hickory_stream.textures import textured_mesh

_CAMERA = Camera(width=4, height=3, fx=5.0, fy=5.0, cx=1.5, cy=1.0)
_POSE = np.eye(4)
_BOX = boxes.OrientedBox(world_from_box=_POSE, half_extents_m=np.ones(3))
_QUADRICS = superquadric.Superquadrics(
    exponents=np.ones((2, 2)), semi_axes_m=np.ones((2, 3)), world_from_local=np.stack([_POSE] * 2)
)
_MESH = mesh.Mesh(
    vertices=np.zeros((3, 3)), faces=np.array([[0, 1, 2]]), colors=np.zeros((3, 3), np.uint8), is_seen=np.ones(3, bool)
)
_CONTAINMENT = records.Containment(num_checked=1, num_outside=0, max_g=0.5)
_RGB, _DEPTH = np.zeros((3, 4, 3), np.uint8), np.ones((3, 4), np.float32)
_CLOUD = {"points_world": np.zeros((5, 3), np.float32), "colors": np.zeros((5, 3), np.uint8)}
_KEYS = np.arange(4)

# fmt: off
VALID = {
    boxes.OrientedBox: {"world_from_box": _POSE, "half_extents_m": np.ones(3)},
    superquadric.Superquadrics: {
        "exponents": np.ones((2, 2)), "semi_axes_m": np.ones((2, 3)), "world_from_local": np.stack([_POSE] * 2),
    },
    textured_mesh.TexturedMesh: {
        "mesh": _MESH, "uv": np.zeros((3, 2)), "image": np.zeros((4, 4, 3), np.uint8), "source": np.arange(3),
    },
    mesh.Mesh: {name: getattr(_MESH, name) for name in ("vertices", "faces", "colors", "is_seen")},
    records.Frame: {
        "index": 0, "stamp_ns": 1, "rgb": _RGB, "depth_m": _DEPTH, "camera": _CAMERA, "world_from_camera": _POSE,
        "degenerate": np.eye(6)[:1],
    },
    records.RawFrame: {
        "index": 0, "stamp_ns": 1, "camera": _CAMERA, "world_from_camera": _POSE, "decode": lambda: None,
        "after_from_before": _POSE,
    },
    records.RejectedMask: {"box_px": (2, 3, 6, 5), "reason": "too small", "mask": np.ones((2, 4), bool)},
    records.CoarseFrame: {
        "stride_px": 4, "depth_mm": np.ones((3, 4), np.uint16), "structure": np.zeros((3, 4), bool), "camera": _CAMERA,
    },
    records.SemanticImage: {"classes": np.zeros((3, 4), np.int32), "labels": ("wall",)},
    records.Segmentation: {
        "instances": np.zeros((3, 4), np.int32), "structure": np.zeros((3, 4), bool),
        "structure_shown": np.zeros((3, 4), bool), "alone": np.zeros((3, 4), np.int32),
    },
    records.Returns: {"depth_mm": np.ones((2, 4), np.uint16), "voxel_m": 0.01, "checksum": 7},
    records.Observation: {
        "index": 0, "box_px": (2, 3, 6, 5), "mask": np.ones((2, 4), bool), **_CLOUD, "box": _BOX, "r_area": 0.1,
        "r_depth": 0.9, "is_cut": False,
    },
    records.SpaceObservation: {"free_keys": _KEYS, "structure_keys": _KEYS, "surface_keys": _KEYS, "floor_z_m": None},
    records.MaskFeature: {"observation_index": 0, "variance": 0.1, "pooled": np.ones(4, np.float32)},
    records.View: {
        "object_id": 1, "frame_index": 7, "stamp_ns": 1, "box_px": (2, 3, 6, 5), "world_from_camera": _POSE,
        "r_area": 0.1, "r_depth": 0.9, "box_volume_m3": 0.2, "score": 0.3, "variance": 0.4,
        "feature": np.ones(4, np.float32),
    },
    records.ObjectShape: {
        "revision": 1, "reconstructor": "fused", "mesh_name": "1.glb", "mesh_sha256": "0", "world_from_object": _POSE,
        "fitted": _QUADRICS, "inflated": _QUADRICS, "seen_share": np.ones(2), "containment": _CONTAINMENT,
    },
    records.TrackedObject: {
        "id": 1, "phase": records.Phase.ACTIVE, "submap_id": 0, "sightings": 3, "first_seen_ns": 1, "last_seen_ns": 2,
        **_CLOUD, "box": _BOX, "feature": np.ones(4, np.float32), "views": (), "best_view": None, "shape": None,
    },
    records.ObservedSpace: {"voxel_m": 0.05, "free": _KEYS, "structure": _KEYS, "floor_z_m": 0.0},
    records.GraphNode: {
        "submap_id": 0, "stamp_ns": 1, "place": _POSE, "uncorrected": _POSE, "sigma_m": 0.1, "sigma_rad": 0.01,
        "covariance_xy": np.eye(2),
    },
    records.Submap: {
        "id": 0, "world_from_submap": _POSE,
        "observed_space": records.ObservedSpace(voxel_m=0.05, free=_KEYS, structure=_KEYS, floor_z_m=None),
    },
    records.SurveyedSubmap: {
        "id": 0, "world_from_submap": _POSE, "anchor": _POSE, "way_m": 1.0, "turn_rad": 0.5, "after_jump": False,
        "points": np.zeros((5, 3), np.float32), "normals": np.ones((5, 3), np.float32), "free": _KEYS, "voxel_m": 0.05,
        "registered": np.eye(6), "blind": np.eye(6), "unfixed": np.eye(6),
    },
    records.Keypoints: {
        "camera": _CAMERA, "world_from_camera": _POSE, "descriptors": np.ones((5, 32), np.uint8),
        "points": np.zeros((5, 3), np.float32),
    },
    records.Loop: {
        "earlier": 0, "later": 3, "earlier_from_later": _POSE, "covariance": np.eye(6), "method": "surface",
        "score": 0.9,
    },
    records.FrameReport: {
        "index": 0, "stamp_ns": 1, "keyframe_index": None, "camera": _CAMERA, "world_from_camera": _POSE,
        "color_bytes": None, "patches": np.ones((2, 3, 5), np.float32),
    },
    records.Scan: {
        "stamp_ns": 1, "frame": "lidar", "points": _CLOUD["points_world"], "times_s": np.zeros(5, np.float32),
    },
    events.FrameObserved: {
        "frame_index": 0, "stamp_ns": 1, "world_from_camera": _POSE, "observations": (),
        "space": records.SpaceObservation(free_keys=_KEYS, structure_keys=_KEYS, floor_z_m=None),
        "degenerate": np.eye(6)[:1],
    },
    events.PoseJumped: {"stamp_ns": 1, "after_from_before": _POSE},
    events.PosesCorrected: {"stamp_ns": 1, "submap_ids": (0,), "world_from_submap": _POSE[None]},
    events.KeyframeRegistered: {
        "frame_index": 3, "stamp_ns": 1, "how": "fits", "odometry_from_camera": _POSE, "map_from_camera": _POSE,
        "map_from_odometry": _POSE, "covariance": np.eye(6), "corrects": True, "num_against": 0, "is_anchor": False,
        "spread_per_m": 0.0025, "fit": 0.97, "degenerate": np.eye(6)[:1],
    },
    events.RequestShape: {
        "ticket": 1, "object_id": 1, "views": (), **_CLOUD, "box": _BOX, "support_z_m": None, "due_ns": 5,
    },
    ports.Crop: {
        "rgb": _RGB, "depth_m": _DEPTH, "mask": np.ones((3, 4), bool), "camera": _CAMERA, "world_from_camera": _POSE,
    },
    ports.ShapeInputs: {"crops": (), **_CLOUD, "box": _BOX, "support_z_m": None},
    ports.Registered: {
        "stamp_ns": 1, "start_from_sensor": _POSE, "information": np.eye(6), "degenerate": np.eye(6)[:1],
    },
    ports.GeneratedMesh: {"mesh": _MESH, "camera_from_mesh": _POSE},
    ports.MeshPlacement: {
        "world_from_mesh": _POSE, "scale": 1.0, "stretch": np.ones(3), "stretch_axes": np.eye(3), "cost": 0.1,
        "sigma_m": 0.01, "sigma_rad": 0.01, "sigma_scale": 0.01, "is_symmetric": False, "margin": 0.5,
    },
    ports.Reconstruction: {"mesh": _MESH, "world_from_object": _POSE},
    ports.BuiltShape: {
        "reconstruction": ports.Reconstruction(mesh=_MESH, world_from_object=_POSE), "fitted": _QUADRICS,
        "inflated": _QUADRICS, "seen_share": np.ones(2), "containment": _CONTAINMENT, "timings_s": {},
    },
}
# fmt: on

# The lengths that nothing else in the record fixes: any other one is as good.
FREE_LENGTH = (
    "Returns.depth_mm Mesh.faces Registered.degenerate Frame.degenerate FrameObserved.degenerate "
    "KeyframeRegistered.degenerate SpaceObservation.free_keys SpaceObservation.structure_keys "
    "SpaceObservation.surface_keys SemanticImage.classes FrameReport.patches MaskFeature.pooled View.feature "
    "TrackedObject.feature ObservedSpace.free ObservedSpace.structure SurveyedSubmap.free".split()
)


def array_fields(record):
    return [field.name for field in fields(record) if "ndarray" in str(field.type).lower()]


def cases():
    for record, values in VALID.items():
        for name in array_fields(record):
            yield pytest.param(record, values, name, id=f"{record.__name__}.{name}")


every_array = pytest.mark.parametrize(("record", "values", "name"), list(cases()))


def test_every_record_with_arrays_is_among_these():
    found = {
        item
        for module in (records, events, ports, boxes, mesh, superquadric, textured_mesh)
        for _, item in inspect.getmembers(module, inspect.isclass)
        if item.__module__ == module.__name__ and is_dataclass(item) and array_fields(item)
    }
    assert found == set(VALID)


@every_array
def test_an_array_of_a_record_is_a_read_only_copy(record, values, name):
    given = np.array(values[name])
    held = getattr(record(**{**values, name: given}), name)
    before = held.copy()
    given[...] = 1 - given.astype(given.dtype)
    assert np.array_equal(held, before)
    with pytest.raises(ValueError, match="read-only"):
        held[...] = 0


@every_array
def test_an_array_with_a_dimension_more_or_less_is_refused(record, values, name):
    array = np.asarray(values[name])
    for wrong in (array[None], array[0]):
        with pytest.raises(ValueError, match=rf"{record.__name__}\.\w+ has shape"):
            record(**{**values, name: wrong})


@every_array
def test_an_array_of_a_wrong_size_is_refused(record, values, name):
    longer = np.concatenate([values[name], values[name][:1]])
    if f"{record.__name__}.{name}" in FREE_LENGTH:
        assert len(getattr(record(**{**values, name: longer}), name)) == len(longer)
        longer = np.zeros((2, 2, 2, 2), longer.dtype)
    with pytest.raises(ValueError, match=rf"{record.__name__}\.\w+ has shape"):
        record(**{**values, name: longer})


@every_array
def test_an_array_is_converted_or_refused_where_that_changes_it(record, values, name):
    dtype = getattr(record(**values), name).dtype
    given = np.asarray(values[name])
    assert getattr(record(**{**values, name: given.astype(np.float64)}), name).dtype == dtype
    wrong = given.astype(np.float64) + 0.5 if dtype.kind in "iub" else given.astype(str)
    with pytest.raises(ValueError, match=rf"{record.__name__}\.{name} has values of"):
        record(**{**values, name: wrong})


@pytest.mark.parametrize("record", VALID, ids=lambda record: record.__name__)
def test_a_record_is_frozen_and_compared_by_identity_only(record):
    made = record(**VALID[record])
    with pytest.raises((FrozenInstanceError, AttributeError)):
        setattr(made, fields(record)[0].name, None)
    assert made == made
    assert made != record(**VALID[record])


def test_the_images_of_a_frame_must_fit_its_camera():
    frame = records.Frame(**VALID[records.Frame])
    with pytest.raises(ValueError, match=r"Frame\.rgb has shape \(3, 4, 3\); expected \(6, 8, 3\)"):
        replace(frame, camera=_CAMERA.scaled(2.0))


def test_an_observations_mask_must_fill_its_box():
    with pytest.raises(ValueError, match=r"Observation\.mask has shape \(2, 4\); expected \(3, 4\)"):
        records.Observation(**{**VALID[records.Observation], "box_px": (2, 3, 6, 6)})


def test_a_view_without_feature_needs_none():
    assert records.View(**{**VALID[records.View], "feature": None}).feature is None


def test_a_views_name_is_its_frame_and_observation():
    view = records.View(**VALID[records.View])
    assert view.name == "000007-000"
    assert replace(view, object_id=99, score=None).name == view.name
    assert replace(view, frame_index=8).name != view.name
    assert replace(view, observation_index=1).name != view.name


def test_a_graph_with_dangling_or_backward_edges_is_refused():
    nodes = tuple(records.GraphNode(**{**VALID[records.GraphNode], "submap_id": i}) for i in (0, 2))
    edge = records.GraphEdge(
        kind="loop", earlier=0, later=2, status="rejected", score=3.0, reason="contradicted", residual_m=1.0,
        residual_rad=0.1, stamp_ns=5,
    )  # fmt: skip
    assert records.PoseGraphRecord(nodes=nodes, edges=(edge,)).loops == (edge,)
    with pytest.raises(ValueError, match="submap 1, which the graph does not have"):
        records.PoseGraphRecord(nodes=nodes, edges=(replace(edge, later=1),))
    with pytest.raises(ValueError, match="ascending order"):
        records.PoseGraphRecord(nodes=nodes[::-1], edges=())
    with pytest.raises(ValueError, match="earlier submap to a later one"):
        replace(edge, later=0)


FROZEN = Path(__file__).parent / "golden" / "record_names.json"


def test_journal_records_keep_their_names_and_fields():
    """A journal written before names them: a name changes only with an alias on reading, and then here."""
    found = {
        name: [member.value for member in kind] if issubclass(kind, Enum)
        else [f.name for f in dataclasses.fields(kind)] for name, kind in sorted(record_classes().items())
    }  # fmt: skip
    assert found == json.loads(FROZEN.read_text(encoding="utf-8"))
