"""What the commands print with `--json`: named, with a version, and of a form that is declared here.

Each output is one object with the keys `output`, its name, and `version`; `hickory-stream schema NAME` prints the form
as JSON Schema. A key that goes, or means something else, makes a new version; one that is added does not.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, NotRequired, TypedDict

from hickory_stream.base.json_schema import schema_of
from hickory_stream.base.json_text import dumps

if TYPE_CHECKING:
    from hickory_stream.batch.result import Overlap
    from hickory_stream.changes.records import ObjectChange
    from hickory_stream.evaluation.trajectory_error import TrajectoryError
    from hickory_stream.map_folder.history.registration_history import RegistrationSummary
    from hickory_stream.map_folder.history.time_travel import Change
    from hickory_stream.map_folder.verify import Finding
    from hickory_stream.perception.models.library import Companion
    from players.live.status import TopicStatus

VERSION = 1

Matrix = list[list[float]]


class Error(TypedDict):
    """Why a command failed; on standard output, beside the line on standard error."""

    event: Literal["error"]
    message: str


class Progress(TypedDict):
    """How far a run is; on standard error, twice a second. `part` is which one of several."""

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


class Compiling(TypedDict):
    """How many kernels were compiled, by a command that shows no other progress; on standard error."""

    event: Literal["progress"]
    phase: Literal["compiling"]
    num_compiled: int


class Metrics(TypedDict):
    """Where `--metrics-port` answers; on standard error."""

    event: Literal["metrics"]
    url: str


class LiveWaiting(TypedDict):
    """What `live` waits for before it can map; on standard error, whenever that changes."""

    event: Literal["waiting"]
    text: str


class LiveGoals(TypedDict):
    """What became of the goals that a robot sent; `dropped`: newer ones came before they were answered."""

    answered: int
    no_path: int
    refused: int
    dropped: int


class LivePublished(TypedDict):
    """What `live --publish` has sent: by topic the messages `sent`, `unheard` (nobody there) and `dropped`."""

    event: Literal["published"]
    topics: dict[str, dict[str, int]]
    goals: LiveGoals


class LiveStatus(TypedDict):
    """How a live route is, by topic; `clock_offset_s` is our clock less the robot's. On standard error."""

    event: Literal["status"]
    uri: str
    kind: str
    is_connected: bool
    problem: str
    clock_offset_s: float | None
    clock_steps: int
    unlisted_topics: int
    topics: list[TopicStatus]


class FailedShapes(TypedDict):
    """Objects without a shape because their jobs failed for one reason; where the inputs of those jobs lie."""

    reason: str
    objects: list[int]
    inputs: list[str]


class Finished(TypedDict):
    """What `play` and `resume` have made; `ledger` says what became of every message and frame.

    `registration` says how keyframes were fitted to the map, None where they were not.
    `lost_outputs` says why a recording or costmap is not there to its end, `damage` where the log is damaged ("" where
    it is sound), `notes` what the map cannot know of floor and gravity, `resume` how a run goes on that was stopped.
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
    resume: NotRequired[str]
    ledger: dict[str, Any]


class Saved(TypedDict):
    """`resume` of a run that cannot be continued: it is saved as of its last step."""

    event: Literal["saved"]
    map: str
    finished_cleanly: Literal[False]
    digest: str | None


class Replayed(TypedDict):
    """What the journal gives; `recorded_digest` is null where the run never ended, `saved_digest` the folder's."""

    event: Literal["replayed"]
    digest: str
    recorded_digest: str | None
    saved_digest: str
    is_same: bool
    objects: int


class Verified(TypedDict):
    """What holds of a map; `num_proven` objects have a layer 4 that was proven anew from their meshes."""

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
    """What `doctor` found; `status` is its exit status. The parts have the keys that the log gives cause for."""

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
    refusal: str | None


class Demonstrated(TypedDict):
    """What `demo` has made, after the outputs of `play` and `render`."""

    log: str
    map: str
    pictures: list[str]


class Rendered(TypedDict):
    """A picture of a map, in pixels; `graph`: of its pose graph, and of no layers."""

    picture: str
    width: int
    height: int
    layers: list[int]
    graph: bool


class Exported(TypedDict):
    """The file that was written, or the first of several `files`; `unproven` is why layer 4 is not, or null."""

    file: str
    format: str
    objects: int
    unproven: str | None
    files: NotRequired[int]


class Differences(TypedDict):
    """What became of the objects between two moments."""

    changes: list[Change]


class SameObject(TypedDict):
    """An object that is in two maps: its ids, and how much its boxes overlap."""

    a: int
    b: int
    iou: float


class MapDifferences(TypedDict):
    """How the ends of two maps differ: objects in both, and the ids of those in one alone."""

    both: list[SameObject]
    only_in_a: list[int]
    only_in_b: list[int]


class DaysDiffer(TypedDict):
    """What became of all objects from one map of a place to a later one, which lies at `a_from_b` in it."""

    a_from_b: Matrix
    sigma_m: float
    objects: list[ObjectChange]


class NotCompared(TypedDict):
    """Two maps that do not align, and why."""

    aligned: Literal[False]
    refusal: str
    reason: str


class Blocker(TypedDict):
    """An object that the robot would touch, or null for a wall, and how far it is."""

    object: int | None
    distance_m: float


class Planned(TypedDict):
    """A path (points in metres, one posture and heading a leg), or the reason why there is none.

    It rests on layer 4 of the objects, but on boxes of `objects_by_box`, and in a live run that goes on on what was
    seen of `objects_observed_only`; `unproven` is why layer 4 is not, or null. A path keeps off `objects_movable` where
    it can; `passes_movable` are those that it passes nearer. `floor_m` is the height of the floor that it lies on.
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
    goal: str
    score: float
    center_m: list[float]
    size_m: list[float]
    why: dict[str, float]


class Queried(TypedDict):
    """What answers a question, best first: `count` objects, the first of them in `answers`.

    `counts`: the question was how many there are. `nearly` are the best of those that do not answer.
    """

    question: str
    counts: bool
    count: int
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
    """A transform that was not believed."""

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
    """Where map b lies in map a, or why that cannot be told."""

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
    pairs: NotRequired[list[Pair]]
    refusal: NotRequired[str]
    reason: NotRequired[str]
    hypotheses: NotRequired[list[Hypothesis]]


class MergedPair(TypedDict):
    """What became of two of the maps."""

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


class FleetSaid(TypedDict):
    """What happens in a fleet, such as a join, in a sentence; on standard error."""

    event: Literal["said"]
    text: str


class FleetJoined(TypedDict):
    """Another robot with which an alignment holds; `since_keyframe` is null where only the finished maps are joined."""

    name: str
    pairs: int
    sigma_m: float
    sigma_deg: float
    since_keyframe: int | None


class FleetRobot(TypedDict):
    """One robot: `frame` is the robot in whose frame it is, itself where it is alone, and `reason` then says why.

    `map`, `digest` and `frame_from_robot` are null where there is none. `notes` say what was lost of its log.
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
    """Two robots that were joined while their maps grew, or are no longer, after so many keyframes."""

    keyframe: int
    kind: Literal["joined", "withdrawn"]
    a: str
    b: str
    a_from_b: Matrix
    pairs: int
    sigma_m: float


class Fleet(TypedDict):
    """What `fleet` has made; `joined`: every robot's map is finished, and all are in one; also in OUT/fleet.json."""

    event: Literal["finished"]
    out: str
    joined: bool
    robots: list[FleetRobot]
    merged: list[FleetMerged]
    joins: list[FleetJoin]
    notes: list[str]


class Located(TypedDict):
    """Where a log is in a map, as known at a stamp; one line an answer."""

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


class Definitions(TypedDict):
    """What the figures of `evaluate` mean."""

    definitions: str


class RejectedMask(TypedDict):
    """A mask that is no object: its box in pixels and the reason."""

    box_px: list[int]
    reason: str


class Segmented(TypedDict):
    """What was found in one frame."""

    picture: str
    masks: int
    objects: int
    rejected: list[RejectedMask]


class Generator(TypedDict):
    """One program that makes shapes; `state` is "ok", or what is wrong with it."""

    name: str
    file: str
    licence: str
    acceptance: str
    state: str


class Generators(TypedDict):
    """The programs in the folder of generators."""

    folder: str
    generators: list[Generator]


class GeneratorChecked(TypedDict):
    """What a generator made of the built-in object; what comes after `state` is absent where it did not get so far.

    `said` is what it told of itself when it was ready; `cost` is what contradicts the placed mesh.
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


class ModelsFolder(TypedDict):
    """Where models are looked for."""

    folder: str


class Model(TypedDict):
    """One network; `state` is "ok", or what is wrong with it. `input_px` is 0 for any."""

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


class Models(TypedDict):
    """The networks that are there."""

    folder: str
    models: list[Model]


class ModelAdded(TypedDict):
    """A network that was added."""

    name: str
    file: str
    sha256: str


class ModelChecked(TypedDict):
    """A network that was run on the built-in picture; what it gives depends on its kind."""

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
    """How much of one kind is kept."""

    entries: int
    bytes: int


class CacheShown(TypedDict):
    """What is kept to save time, by kind."""

    folder: str
    cap_mb: float
    kinds: dict[str, CacheKind]


class CacheCleared(TypedDict):
    """Which kinds were removed, and how much that was."""

    folder: str
    cleared: list[str]
    bytes: int


class ConfigChecked(TypedDict):
    """A configuration that is sound; an error otherwise."""

    ok: Literal[True]


class Estimated(TypedDict):
    """What `odometry` found: frames with a pose and `lost` ones, scans, those `degenerate`, and processor time."""

    poses: int
    pose: str
    lost: int
    degenerate: int
    scans: int
    seconds: float
    error: TrajectoryError | None


class BatchSaid(TypedDict):
    """What happens in a batch, in a sentence; on standard error."""

    event: Literal["said"]
    text: str


class BatchLog(TypedDict):
    """What came of a log; `resumed`: it went on with a map that was begun, `was_there`: it was finished before."""

    log: str
    map: str
    was_there: bool
    name: str
    state: Literal["mapped", "failed", "disk full"]
    reason: str
    digest: str | None
    processor: str
    keyframes: int
    objects: int
    wall_s: float
    cpu_s: float
    map_mb: float
    resumed: bool
    worker: str


class BatchMerged(TypedDict):
    """One map of several logs; `united` of its objects are in several of their maps."""

    map: str
    logs: list[str]
    digest: str | None
    objects: int
    united: int


class BatchJoined(TypedDict):
    """Where the maps overlap: of all `pairs` those that were `aligned`; `signature_kb` is a place signature's size."""

    pairs: int
    aligned: list[Overlap]
    merged: list[BatchMerged]
    signature_kb: float
    problems: list[str]


class Batch(TypedDict):
    """What `batch` has made, also in OUT/result.json; `stopped` says why it ended early, "" where it did not."""

    event: Literal["finished"]
    out: str
    finished: bool
    stopped: str
    wall_s: float
    logs: list[BatchLog]
    joined: BatchJoined | None


OUTPUTS: dict[str, Any] = {
    "batch": Batch,
    "batch-said": BatchSaid,
    "odometry": Estimated,
    "demo": Demonstrated,
    "error": Error,
    "progress": Progress,
    "compiling": Compiling,
    "metrics": Metrics,
    "live-waiting": LiveWaiting,
    "live-status": LiveStatus,
    "live-published": LivePublished,
    "play": Finished,
    "fleet": Fleet,
    "fleet-said": FleetSaid,
    "resume-saved": Saved,
    "replay": Replayed,
    "doctor": Diagnosis,
    "inspect": "hickory_stream.inspection.inspect.MapSummary",
    "verify": Verified,
    "render": Rendered,
    "export": Exported,
    "diff": Differences,
    "diff-maps": MapDifferences,
    "diff-days": DaysDiffer,
    "diff-refused": NotCompared,
    "query": Queried,
    "plan": Planned,
    "align": Aligned,
    "merge": Merged,
    "relocalise": Located,
    "reconstruct": Reconstructed,
    "evaluate": "hickory_stream.evaluation.evaluate.Evaluation",
    "evaluate-explain": Definitions,
    "explain": "hickory_stream.inspection.point_history.PlaceStory",
    "explain-object": "hickory_stream.evaluation.why.ObjectStory",
    "explain-truth": "hickory_stream.evaluation.why.Why",
    "segment": Segmented,
    "generators-list": Generators,
    "generators-check": GeneratorChecked,
    "models-where": ModelsFolder,
    "models-list": Models,
    "models-add": ModelAdded,
    "models-check": ModelChecked,
    "config-dump": "hickory_stream.settings.Settings",
    "config-check": ConfigChecked,
    "cache-show": CacheShown,
    "cache-clear": CacheCleared,
}
"""The form of each output, by its name; those of other modules by their path, so that they load only when asked for."""


def output(name: str, data: dict[str, Any], *, indent: int | None = None) -> str:
    """Return what a command prints: its data as JSON, with the name of the output and its version."""
    if name not in OUTPUTS:
        raise KeyError(f"{name} is no output: declare it in OUTPUTS")
    return dumps({"output": name, "version": VERSION, **data}, indent=indent)


def output_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of an output."""
    kind = OUTPUTS[name]
    if isinstance(kind, str):
        module, _, attribute = kind.rpartition(".")
        kind = getattr(import_module(module), attribute)
    schema = schema_of(kind)
    head = {"output": {"const": name}, "version": {"const": VERSION}}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"hickory-stream {name}",
        **schema,
        "properties": head | schema["properties"],
        "required": [*head, *schema["required"]],
    }
