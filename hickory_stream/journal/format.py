"""The format of `journal.mcap`: every event of a run, step by step, to resume, replay and inspect it.

Each step is one compressed chunk with a CRC: a file that was cut anywhere holds all steps before the cut. Messages are
CBOR (`record_codec`), one channel per kind of event. Further channels: `step` (position of the run), `checkpoint`
(state of the core), `color` (compressed images of keyframes), `told` (decisions). Log time is the stamp.

A checkpoint is two chunks, so that its records are read without its arrays. First comes `checkpoint/arrays`: each array
is a frame of zstd with a checksum. Then come the records, which refer to arrays and records by chunk and place in it
(the first message of either chunk is neither).

Observations are stored as returns of their masks instead of points (`packed_frames`).

Before a step's chunk is one with the changed public records of the map, without points and space (`known_records`):
first their places, then the records.

A chunk reaches the operating system at the end of its step, and the disk (fsync) at most `flush_s` later: a killed
process loses nothing, a lost power supply that much.
"""

JOURNAL = "journal.mcap"
MAGIC = b"\x89MCAP0\r\n"
PROFILE = "hickory-stream/1"
STEP, COLOR, TOLD, CHECKPOINT, ARRAYS, KNOWN = 1, 3, 4, 5, 6, 7
TOPICS = {
    STEP: "step",
    COLOR: "color",
    TOLD: "told",
    CHECKPOINT: "checkpoint/2",
    ARRAYS: "checkpoint/arrays",
    KNOWN: "known",
}
ENCODINGS = {COLOR: "image", ARRAYS: "cbor+zstd"}
"""Of messages that are not plain CBOR."""
# A place in this list is part of the format: what is new comes last.
_EVENTS = (
    "FrameObserved",
    "FeaturesReady",
    "ShapeReady",
    "ShapeFailed",
    "TimeJumped",
    "SourceEnded",
    "PoseJumped",
    "PosesCorrected",
    "LoopsSearched",
    "WayEnded",
    "KeyframeRegistered",
    "KeyframeKeptOut",
)
CHANNELS = {name: 16 + i for i, name in enumerate(_EVENTS)}
EVENT_NAMES = {channel: name for name, channel in CHANNELS.items()}
