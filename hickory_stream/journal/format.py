"""The format of `journal.mcap`: every event of a run, step by step, to resume, replay and inspect it.

Each step is one compressed chunk with a CRC: a file that was cut anywhere holds all steps before the cut. Messages are
CBOR (see `record_codec`), one channel per kind of event; the channel `step` says where the run stood, `checkpoint`
holds the core's state now and then, `color` the compressed images of keyframes, `told` the decisions of a step (older
journals have none). The log time is the stamp.

A checkpoint is two chunks, so that its records are read without its arrays: first `checkpoint/arrays`, each array a
frame of zstd by itself with a checksum, then the records, which name arrays and records by the number of their chunk
and their place in it (the first message of either chunk is none of these). Older journals have arrays and records in
one chunk.

What was observed in a keyframe is stored with the returns of its masks instead of their points, which are made of them
again (`packed_frames`); older journals have the points.

Before the chunk of a step is one of its own with what of the map's public records the step has changed, without points
and space (`known_records`): first where they are, then the records. Older journals have none.

A chunk reaches the operating system when its step is over, so that a killed process loses nothing of it; it reaches the
disk (fsync) at most `flush_s` later, which is what a lost power supply may cost.
"""

from __future__ import annotations

JOURNAL = "journal.mcap"
MAGIC = b"\x89MCAP0\r\n"
PROFILE = "hickory-stream/1"
STEP, OLD_CHECKPOINT, COLOR, TOLD, CHECKPOINT, ARRAYS, KNOWN = 1, 2, 3, 4, 5, 6, 7
"""Checkpoints of older journals have records of another form: they are not read, the events are all that is needed."""

TOPICS = {
    STEP: "step",
    OLD_CHECKPOINT: "checkpoint",
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
