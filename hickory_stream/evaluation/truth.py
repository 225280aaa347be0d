"""The truth folder of a synthetic log: `truth.json` beside GLB meshes and instance images.

The format number changes when a reader would misread the file. Poses are exact; the world is z up.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.confined import OutsideError, path_within, read_within
from hickory_stream.errors import RecordingError
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.mesh import Mesh, mesh_of_glb
from hickory_stream.geometry.rigid import apply
from hickory_stream.map_folder.codec import INT, NUMBER, POSE, STAMP, TEXT, list_form, record_form

FORMAT = 1
TRUTH_FILE = "truth.json"
_SAME_STAMP_NS = 1_000_000


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TruthObject:
    """One true object: `mesh` is a path inside the folder, in the object's frame; `seen_fraction` in 0..1.

    `frames` are the frames in which at least one pixel shows it.
    """

    id: int
    kind: str
    mesh: str
    world_from_object: NDArray[np.float64]
    seen_fraction: float
    frames: tuple[int, ...]

    def __post_init__(self) -> None:
        freeze(self, "world_from_object", np.float64, (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TruthFrame:
    """One true frame; `instances` is the path of its uint16 image inside the folder, 0 = no object."""

    index: int
    stamp_ns: int
    world_from_camera: NDArray[np.float64]
    instances: str
    #: None: the truth's
    camera: Camera | None = None

    def __post_init__(self) -> None:
        freeze(self, "world_from_camera", np.float64, (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TruthChange:
    """A change during a log: from `stamp_ns` on the truth's objects are valid.

    `before` are the earlier states of moved and removed objects, sorted by id, with `seen_fraction` until the change.
    """

    stamp_ns: int
    before: tuple[TruthObject, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Truth:
    """A truth folder: objects sorted by id, frames by index; `structure` are paths of meshes in the folder's world."""

    folder: Path
    camera: Camera
    objects: tuple[TruthObject, ...]
    structure: tuple[str, ...]
    frames: tuple[TruthFrame, ...]
    #: None for a static world; otherwise `objects` are the final ones
    change: TruthChange | None = None
    #: (4, 4) to the world of the poses, None if it is the same
    world_from_folder: NDArray[np.float64] | None = None
    #: by the names that objects and structure have for them; of a data set (`data_sets`), whose folder has no GLB
    meshes: Mapping[str, Mesh] | None = None
    #: how the instances of a frame are found without an image in the folder
    paint: Callable[[TruthFrame], NDArray[np.uint16]] | None = None


def load_truth(folder: Path) -> Truth:
    """Return the truth in a folder; meshes and images are read on demand. Raises `RecordingError`."""
    path = folder / TRUTH_FILE
    try:
        record = json.loads(read_within(folder, TRUTH_FILE))
    except FileNotFoundError as error:
        raise RecordingError(
            f"{folder} is no truth folder: it has no {TRUTH_FILE}. A synthetic recording "
            "has one beside its log (NAME.truth); labels by hand are a file boxes.json, for `evaluate`"
        ) from error
    except (OSError, ValueError, RecursionError) as error:
        raise RecordingError(f"{path} cannot be read as JSON: {error}. Make the recording again") from error
    found = record.get("format") if isinstance(record, dict) else None
    if found != FORMAT:
        raise RecordingError(f"{path} has format {found!r}; expected {FORMAT}. Make the recording again")
    try:
        return _truth_of(folder, record)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise RecordingError(f"{path} is damaged ({error!r}). Make the recording again") from error


def mesh_of(truth: Truth, item: TruthObject) -> Mesh:
    """Return the mesh of an object in its own frame; raises `RecordingError` if it cannot be read."""
    return _mesh_at(truth, item.mesh)


def structure_meshes(truth: Truth) -> tuple[Mesh, ...]:
    """Return floor, walls and the like in the world of the poses; raises `RecordingError` if a file cannot be read."""
    meshes = tuple(_mesh_at(truth, path) for path in truth.structure)
    if truth.world_from_folder is None:
        return meshes
    return tuple(moved_mesh(mesh, truth.world_from_folder) for mesh in meshes)


def moved_truth(truth: Truth, a_from_world: NDArray[np.float64]) -> Truth:
    """Return the truth in another world: objects, cameras and structure."""
    before = np.eye(4) if truth.world_from_folder is None else truth.world_from_folder

    def moved(objects: tuple[TruthObject, ...]) -> tuple[TruthObject, ...]:
        return tuple(replace(o, world_from_object=a_from_world @ o.world_from_object) for o in objects)

    return replace(
        truth,
        objects=moved(truth.objects),
        change=None if truth.change is None else replace(truth.change, before=moved(truth.change.before)),
        frames=tuple(replace(f, world_from_camera=a_from_world @ f.world_from_camera) for f in truth.frames),
        world_from_folder=a_from_world @ before,
    )


def moved_mesh(mesh: Mesh, a_from_b: NDArray[np.float64]) -> Mesh:
    """Return a mesh moved from frame b to frame a."""
    vertices = apply(a_from_b, mesh.vertices.astype(np.float64)).astype(np.float32)
    return Mesh(vertices=vertices, faces=mesh.faces, colors=mesh.colors, is_seen=mesh.is_seen)


def instances_of(truth: Truth, frame: TruthFrame) -> NDArray[np.uint16]:
    """Return the (H, W) object id of each pixel, 0 for none; raises `RecordingError` for a missing or damaged image."""
    import cv2

    if truth.paint is not None:
        return truth.paint(frame)
    try:
        path = path_within(truth.folder, frame.instances)
    except OutsideError as error:
        raise RecordingError(f"{error}. Make the recording again") from error
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
    size = (truth.camera.height, truth.camera.width)
    if image is None or image.dtype != np.uint16 or image.shape != size:
        found = "nothing readable" if image is None else f"{image.dtype} {image.shape}"
        raise RecordingError(f"{path} holds {found}; expected uint16 {size}. Make the recording again")
    return np.asarray(image, dtype=np.uint16)


def truth_record(truth: Truth) -> dict[str, Any]:
    """Return the content of `truth.json`."""
    camera = truth.camera
    return {
        "format": FORMAT,
        "camera": {"width": camera.width, "height": camera.height, "K": camera.K.tolist()},
        "objects": _OBJECTS.write(truth.objects),
        "structure": list(truth.structure),
        "frames": _FRAMES.write(truth.frames),
        **({} if truth.change is None else {"change": _CHANGE.write(truth.change)}),
    }


_OBJECTS = list_form(record_form(TruthObject, {
    "id": INT, "kind": TEXT, "mesh": TEXT, "world_from_object": POSE, "seen_fraction": NUMBER, "frames": list_form(INT),
}))  # fmt: skip
_FRAMES = list_form(
    record_form(TruthFrame, {"index": INT, "stamp_ns": STAMP, "world_from_camera": POSE, "instances": TEXT})
)
_CHANGE = record_form(
    lambda stamp_ns, before: TruthChange(stamp_ns=stamp_ns, before=_by_id(before)),
    {"stamp_ns": STAMP, "before": _OBJECTS},
)


def _by_id(objects: Iterable[TruthObject]) -> tuple[TruthObject, ...]:
    return tuple(sorted(objects, key=lambda item: item.id))


def _truth_of(folder: Path, record: dict[str, Any]) -> Truth:
    camera, K = record["camera"], np.array(record["camera"]["K"], dtype=np.float64)
    if K.shape != (3, 3):
        raise ValueError(f"K has shape {K.shape}; expected (3, 3)")
    return Truth(
        folder=folder,
        camera=Camera(
            width=int(camera["width"]), height=int(camera["height"]), fx=K[0, 0], fy=K[1, 1], cx=K[0, 2], cy=K[1, 2]
        ),
        objects=_by_id(_OBJECTS.read(record["objects"])),
        structure=tuple(str(path) for path in record["structure"]),
        frames=tuple(sorted(_FRAMES.read(record["frames"]), key=lambda frame: frame.index)),
        change=_CHANGE.read(record["change"]) if "change" in record else None,
    )


def _mesh_at(truth: Truth, name: str) -> Mesh:
    if truth.meshes is not None:
        return truth.meshes[name]
    try:
        return mesh_of_glb(read_within(truth.folder, name))
    except (OSError, ValueError) as error:
        raise RecordingError(
            f"{truth.folder / name} cannot be read as a mesh: {error}. Make the recording again"
        ) from error


def frame_at(stamps: NDArray[np.int64], stamp_ns: int) -> int | None:
    """Return the index of a stamp in (N,) stamps to within a millisecond, else None."""
    if not len(stamps):
        return None
    i = int(np.argmin(np.abs(stamps - stamp_ns)))
    return i if abs(int(stamps[i]) - stamp_ns) <= _SAME_STAMP_NS else None
