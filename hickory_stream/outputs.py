"""Forms of the `--json` outputs of commands, each with a name and a version.

`hickory-stream schema NAME` prints a form as JSON Schema. A removed key, or a key with a new meaning, makes a new
version; an added one does not.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, NotRequired, TypedDict

from hickory_stream.base.json_schema import schema_of
from hickory_stream.base.json_text import dumps

if TYPE_CHECKING:
    from hickory_stream.batch.result import Overlap, Row
    from hickory_stream.changes.records import ObjectChange
    from hickory_stream.evaluation.trajectory_error import TrajectoryError
    from hickory_stream.map_folder.history.candidates import Candidates
    from hickory_stream.map_folder.history.registration_history import RegistrationSummary
    from hickory_stream.map_folder.history.time_travel import Change
    from hickory_stream.map_folder.verify import Finding
    from hickory_stream.perception.models.library import Companion
    from hickory_stream.records import ObjectKind

VERSION = 1

Matrix = list[list[float]]


class Progress(TypedDict):
    """Progress of a run; on standard error, twice a second. `part` names one of several runs."""

    event: Literal["progress"]
    part: NotRequired[str]
    phase: str
    frames: int
    total: int | None
    keyframes: int
    objects: int
    open_shapes: int
    num_compiled: int
    num_kernels: int


class LiveGoals(TypedDict):
    """Goals of a robot by outcome; `dropped`: newer ones came first."""

    answered: int
    no_path: int
    refused: int
    dropped: int


class FailedShapes(TypedDict):
    """Objects without a shape because their jobs failed for one reason, and the inputs of those jobs."""

    reason: str
    objects: list[int]
    inputs: list[str]


class Finished(TypedDict):
    """Result of `play` and `resume`; `ledger` counts every message and frame by outcome.

    `registration` says how keyframes were fitted to the map, None if they were not. `lost_outputs` are incomplete
    recordings and costmaps, `damage` is of the log ("" for a sound one), `notes` are about floor and gravity, `resume`
    is the command that continues a stopped run. `candidates` is None if the journal lacks the decisions.
    """

    event: Literal["finished"]
    map: str
    finished_cleanly: bool
    is_reproducible: bool
    processor: str | None
    digest: str | None
    objects: int
    objects_with_shape: int
    failed_shapes: list[FailedShapes]
    lost_outputs: list[str]
    damage: str
    notes: list[str]
    registration: RegistrationSummary | None
    candidates: Candidates | None
    resume: NotRequired[str]
    ledger: dict[str, Any]


class Replayed(TypedDict):
    """Result of a journal; `recorded_digest` is null if the run never ended, `saved_digest` is the folder's."""

    event: Literal["replayed"]
    digest: str
    recorded_digest: str | None
    saved_digest: str
    is_same: bool
    objects: int


class Verified(TypedDict):
    """Checks of a map; `num_proven` objects have a layer 4 that was proven again from their meshes."""

    event: Literal["verified"]
    map: str
    is_sound: bool
    is_mended: bool
    digest: str
    recorded_digest: str | None
    num_objects: int
    num_proven: int
    findings: list[Finding]


class Diagnosis(TypedDict):
    """Findings of `doctor`; `status` is its exit status. The parts have only the keys that the log supports."""

    verdict: Literal["sound", "usable with losses", "unusable"]
    status: int
    uri: str
    kind: str
    num_bytes: int
    checksum: str
    streams: dict[str, str]
    topics: dict[str, dict[str, Any]]
    tf: dict[str, Any]
    images: dict[str, Any]
    sync: dict[str, Any]
    frames: dict[str, Any]
    ledger: dict[str, Any]
    damage: list[dict[str, Any]]
    damaged_bytes: int
    estimate: dict[str, float]
    live: dict[str, Any]
    problems: list[str]
    notes: list[str]
    fixes: dict[str, Any]
    refusal: str | None


class Differences(TypedDict):
    """Changes of objects between two moments."""

    changes: list[Change]


class SameObject(TypedDict):
    """An object in two maps: its ids, and the overlap of its boxes."""

    a: int
    b: int
    iou: float


class DaysDiffer(TypedDict):
    """Changes of all objects from one map of a place to a later one at `a_from_b`."""

    a_from_b: Matrix
    sigma_m: float
    objects: list[ObjectChange]


class Blocker(TypedDict):
    """An object that the robot would touch, or null for a wall, and its distance; `kind` is null without an object."""

    object: int | None
    kind: ObjectKind | None
    fixture_probability: float | None
    distance_m: float


class Planned(TypedDict):
    """A path (points in metres, one posture and heading a leg), or the reason why there is none.

    The plan rests on layer 4 of the objects, but on boxes of `objects_by_box`, and in a live run on the seen points of
    `objects_observed_only`; `unproven` is why layer 4 is not proven, or null. A path avoids `objects_movable` or
    lists them in `passes_movable`. `floor_m` is the height of its floor.
    """

    robot: str
    objects_by_box: list[int]
    objects_observed_only: list[int]
    objects_uncertified: list[int]
    unproven: str | None
    objects_movable: list[int]
    cell_m: float
    floor_m: float
    found: bool
    length_m: NotRequired[float]
    passes_movable: NotRequired[list[int]]
    points: NotRequired[Matrix]
    postures: NotRequired[list[str]]
    headings_rad: NotRequired[list[float]]
    iterations: NotRequired[int]
    reason: NotRequired[str]
    text: NotRequired[str]
    blockers: NotRequired[list[Blocker]]


class QueryAnswer(TypedDict):
    """An object that answers; `plan --goal` takes `goal`. `why` has each condition in words with its score in 0..1.

    `score` is the least of them; `size_m` are the longer and the shorter horizontal side, and the height.
    """

    object: int
    kind: ObjectKind
    fixture_probability: float
    goal: str
    score: float
    center_m: list[float]
    size_m: list[float]
    why: dict[str, float]


class Queried(TypedDict):
    """Answers to a question, best first: `count` objects, the first of them in `answers`.

    `counts`: the question asked for a number. `nearly` are the best of the other objects.
    """

    question: str
    counts: bool
    count: int
    by: Literal["geometry and colour alone", "geometry, colour and an image-text network"]
    answers: list[QueryAnswer]
    nearly: list[QueryAnswer]


class Pair(TypedDict):
    """One object in both maps."""

    a: int
    b: int
    semantic: float | None
    geometric: float | None
    rank: float
    residual_m: float


class Hypothesis(TypedDict):
    """A transform that was rejected."""

    a_from_b: Matrix
    num_pairs: int
    log10_chance: float


class Rival(TypedDict):
    """A significant transform: of a refusal one that may be right, of an alignment one that is ruled out."""

    a_from_b: Matrix
    covariance: Matrix
    center_a: list[float]
    num_pairs: int
    log10_chance: float
    margin: float


class Aligned(TypedDict):
    """Transform of map b to map a, or why none was found."""

    aligned: bool
    notes: list[str]
    expected: int
    missing: int
    missing_in_b: list[int]
    missing_in_a: list[int]
    rivals: list[Rival]
    a_from_b: NotRequired[Matrix]
    covariance: NotRequired[Matrix]
    center_a: NotRequired[list[float]]
    translation_sigma_m: NotRequired[float]
    rotation_sigma_deg: NotRequired[float]
    log10_chance: NotRequired[float]
    margin: NotRequired[float]
    is_level: NotRequired[bool]
    is_refined: NotRequired[bool]
    is_weak: NotRequired[bool]
    pairs: NotRequired[list[Pair]]
    refusal: NotRequired[str]
    reason: NotRequired[str]
    hypotheses: NotRequired[list[Hypothesis]]


class MergedPair(TypedDict):
    """Outcome of two of the maps."""

    a: str
    b: str
    believed: bool
    outcome: str


class Merged(TypedDict):
    """One map of several; `united` objects are in more than one of them."""

    merged: bool
    map: str
    pairs: list[MergedPair]
    left_out: list[str]
    objects: NotRequired[int]
    united: NotRequired[int]
    digest: NotRequired[str | None]


class FleetJoined(TypedDict):
    """Alignment with another robot; `since_keyframe` is null if only the finished maps are joined."""

    name: str
    pairs: int
    sigma_m: float
    sigma_deg: float
    since_keyframe: int | None


class FleetRobot(TypedDict):
    """One robot: `frame` names the robot that defines its frame, itself if alone, for the `reason`.

    `map`, `digest` and `frame_from_robot` are null without a map. `notes` are losses of its log.
    """

    name: str
    map: str | None
    digest: str | None
    keyframes: int
    objects: int
    finished: bool
    frame: str
    frame_from_robot: Matrix | None
    joined_with: list[FleetJoined]
    reason: str
    notes: list[str]


class FleetMerged(TypedDict):
    """The merged map of the robots in one frame; `united` objects are in several robots' maps."""

    map: str
    robots: list[str]
    digest: str | None
    objects: int
    united: int


class FleetJoin(TypedDict):
    """A join of two robots while their maps grew, or its withdrawal, after `keyframe` keyframes."""

    keyframe: int
    kind: Literal["joined", "withdrawn"]
    a: str
    b: str
    a_from_b: Matrix
    pairs: int
    sigma_m: float


class Fleet(TypedDict):
    """Result of `fleet`, also in OUT/fleet.json; `joined`: every robot's map is finished, and all are in one."""

    event: Literal["finished"]
    out: str
    joined: bool
    robots: list[FleetRobot]
    merged: list[FleetMerged]
    joins: list[FleetJoin]
    notes: list[str]


class Located(TypedDict):
    """Position of a log in a map at a stamp; one line an answer."""

    event: Literal["located", "searching"]
    stamp_ns: int
    objects: int
    confirmed: bool
    jumped: bool
    map_from_log: NotRequired[Matrix]
    pairs: NotRequired[int]
    translation_sigma_m: NotRequired[float]
    log10_chance: NotRequired[float]
    refusal: NotRequired[str]
    reason: NotRequired[str]


class Reconstructed(TypedDict):
    """The mesh of a shape job, or why there is none."""

    shape: str | None
    reason: NotRequired[str]
    superquadrics: NotRequired[int]
    seconds: NotRequired[dict[str, float]]


class RejectedMask(TypedDict):
    """A mask that is no object: its box in pixels and the reason."""

    box_px: list[int]
    reason: str


class Generator(TypedDict):
    """A shape generator; `state` is "ok" or the problem."""

    name: str
    file: str
    licence: str
    acceptance: str
    state: str


class GeneratorChecked(TypedDict):
    """Check of a generator on the built-in object; keys after `state` are absent if it failed before.

    `said` is its own description when ready; `cost` is the contradiction of the placed mesh by the views.
    """

    name: str
    file: str
    command: str
    licence: str
    acceptance: str
    weights: int
    missing: list[str]
    is_usable: bool
    state: str
    fingerprint: NotRequired[str]
    start_s: NotRequired[float]
    said: NotRequired[dict[str, str]]
    job_s: NotRequired[float]
    memory_mb: NotRequired[float]
    vertices: NotRequired[int]
    triangles: NotRequired[int]
    cost: NotRequired[float]
    picture: NotRequired[str]


class Model(TypedDict):
    """One network; `state` is "ok" or the problem. `input_px` is 0 for any."""

    name: str
    kind: str
    file: str
    sha256: str
    source: str
    licence: str
    input_px: list[int]
    labels: list[str]
    companions: list[Companion]
    state: str


class ModelChecked(TypedDict):
    """Check of a network on the built-in picture; the results depend on its kind."""

    name: str
    kind: str
    provider: str
    providers: list[str]
    warm_up_ms: float
    run_ms: float
    masks: NotRequired[int]
    not_finite: NotRequired[int]
    patches: NotRequired[list[int]]
    dim: NotRequired[int]
    classes: NotRequired[dict[str, float]]
    similarity: NotRequired[dict[str, float]]
    picture: NotRequired[str]


class CacheKind(TypedDict):
    """Size of one kind of cached data."""

    entries: int
    bytes: int


class Estimated(TypedDict):
    """Result of `odometry`: frames with a pose and `lost` ones, scans, `degenerate` ones, and processor time."""

    poses: int
    pose: str
    lost: int
    degenerate: int
    scans: int
    seconds: float
    error: TrajectoryError | None


class BatchMerged(TypedDict):
    """One map of several logs; `united` objects are in several of their maps."""

    map: str
    logs: list[str]
    digest: str | None
    objects: int
    united: int


class BatchJoined(TypedDict):
    """Overlaps of the maps: of all `pairs` the `aligned` ones; `signature_kb` is the mean size of a place signature."""

    pairs: int
    aligned: list[Overlap]
    merged: list[BatchMerged]
    signature_kb: float
    problems: list[str]


class Batch(TypedDict):
    """Result of `batch`, also in OUT/result.json; `stopped` is the reason of an early end, "" otherwise."""

    event: Literal["finished"]
    out: str
    finished: bool
    stopped: str
    wall_s: float
    logs: list[Row]
    joined: BatchJoined | None


OUTPUTS: dict[str, Any] = {
    "batch": Batch,
    "batch-said": ("An event of a batch in a sentence; on standard error.", {"event": Literal["said"], "text": str}),
    "odometry": Estimated,
    "demo": (
        "Files of `demo`, after the outputs of `play` and `render`.",
        {"log": str, "map": str, "pictures": list[str]},
    ),
    "error": (
        "Why a command failed; on standard output, beside the line on standard error.",
        {"event": Literal["error"], "message": str},
    ),
    "progress": Progress,
    "compiling": (
        "Number of compiled kernels, by a command that shows no other progress; on standard error.",
        {"event": Literal["progress"], "phase": Literal["compiling"], "num_compiled": int},
    ),
    "metrics": ("Address of `--metrics-port`; on standard error.", {"event": Literal["metrics"], "url": str}),
    "live-waiting": (
        "The event that `live` waits for before it maps; on standard error, at each change.",
        {"event": Literal["waiting"], "text": str},
    ),
    "live-status": "players.live.status.LiveStatus",
    "live-published": (
        "Messages of `live --publish` by topic: `sent`, `unheard` (no subscriber) and `dropped`.",
        {"event": Literal["published"], "topics": dict[str, dict[str, int]], "goals": LiveGoals},
    ),
    "play": Finished,
    "fleet": Fleet,
    "fleet-said": (
        "An event of a fleet, such as a join, in a sentence; on standard error.",
        {"event": Literal["said"], "text": str},
    ),
    "resume-saved": (
        "`resume` of a run that cannot be continued: its map is saved as of its last step.",
        {"event": Literal["saved"], "map": str, "finished_cleanly": Literal[False], "digest": str | None},
    ),
    "replay": Replayed,
    "doctor": Diagnosis,
    "inspect": "hickory_stream.inspection.inspect.MapSummary",
    "verify": Verified,
    "render": (
        "A picture of a map, in pixels; `graph`: of its pose graph, without layers.",
        {"picture": str, "width": int, "height": int, "layers": list[int], "graph": bool},
    ),
    "export": (
        "The written file, or the first of several `files`; `unproven` is why layer 4 is not proven, or null; "
        "`open_meshes` of glb, stl and obj are not watertight.",
        {
            "file": str,
            "format": str,
            "objects": int,
            "unproven": str | None,
            "open_meshes": int,
            "files": NotRequired[int],
        },
    ),
    "diff": Differences,
    "diff-maps": (
        "Differences of the ends of two maps: objects in both, and ids in one only.",
        {"both": list[SameObject], "only_in_a": list[int], "only_in_b": list[int]},
    ),
    "diff-days": DaysDiffer,
    "diff-refused": (
        "Two maps that do not align, and the reason.",
        {"aligned": Literal[False], "refusal": str, "reason": str},
    ),
    "query": Queried,
    "plan": Planned,
    "align": Aligned,
    "merge": Merged,
    "relocalise": Located,
    "reconstruct": Reconstructed,
    "evaluate": "hickory_stream.evaluation.evaluate.Evaluation",
    "evaluate-labels": "hickory_stream.evaluation.match.Score",
    "evaluate-explain": ("What the figures of `evaluate` mean.", {"definitions": str}),
    "explain": "hickory_stream.inspection.point_history.PlaceStory",
    "explain-object": "hickory_stream.evaluation.why.ObjectStory",
    "explain-truth": "hickory_stream.evaluation.why.Why",
    "segment": (
        "Masks of one frame; `floor_below_m` is None without a floor in view.",
        {"picture": str, "masks": int, "objects": int, "floor_below_m": float | None, "rejected": list[RejectedMask]},
    ),
    "generators-list": ("The generators in their folder.", {"folder": str, "generators": list[Generator]}),
    "generators-check": GeneratorChecked,
    "models-where": ("Folder of the models.", {"folder": str}),
    "models-list": ("Networks in the folder of models.", {"folder": str, "models": list[Model]}),
    "models-add": (
        "A network that was added; `compared` says how an exported graph agrees with its package.",
        {"name": str, "file": str, "sha256": str, "licence": str, "compared": str | None},
    ),
    "models-check": ModelChecked,
    "config-dump": "hickory_stream.settings.Settings",
    "config-check": ("A valid configuration; an error otherwise.", {"ok": Literal[True]}),
    "cache-show": ("Cached data by kind.", {"folder": str, "cap_mb": float, "kinds": dict[str, CacheKind]}),
    "cache-clear": (
        "Removed kinds of cached data, and their size.",
        {"folder": str, "cleared": list[str], "bytes": int},
    ),
}
"""Form of each output: a record, its path (loaded on demand), or a description with the types of its keys."""


def picked(record: Any, *names: str) -> dict[str, Any]:
    """Return fields of a record by name, arrays as lists."""
    fields = {name: getattr(record, name) for name in names}
    return {name: value.tolist() if hasattr(value, "tolist") else value for name, value in fields.items()}


def output(name: str, data: dict[str, Any], *, indent: int | None = None) -> str:
    """Return data as JSON with the name and version of the output."""
    if name not in OUTPUTS:
        raise KeyError(f"{name} is no output: declare it in OUTPUTS")
    return dumps({"output": name, "version": VERSION, **data}, indent=indent)


def output_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of an output."""
    kind = OUTPUTS[name]
    if isinstance(kind, str):
        module, _, attribute = kind.rpartition(".")
        kind = getattr(import_module(module), attribute)
    if isinstance(kind, tuple):
        record: Any = TypedDict(name, kind[1])  # type: ignore[misc]
        record.__doc__, kind = kind[0], record
    schema = schema_of(kind)
    head = {"output": {"const": name}, "version": {"const": VERSION}}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"hickory-stream {name}",
        **schema,
        "properties": head | schema["properties"],
        "required": [*head, *schema["required"]],
    }
