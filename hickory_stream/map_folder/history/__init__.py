"""The past of a run, from its journal alone.

The journal holds every event that the core was given, step by step (`engine.journal`). All that is done with it begins
with one thing: `core_replay` gives the events to a core again, from the beginning or from the last checkpoint.

- `resume` continues a run that was interrupted, from its `resume_point`.
- `rewind` takes a running playback back to an earlier stamp.
- `replay` shows a run to sinks again.
- `time_travel` says what was known at a moment, and what changed between two.
- `recorded` and `track_histories` say what was decided, and why: for `explain` and the viewer.

`recorded_config` is the configuration that goes with it.
"""
