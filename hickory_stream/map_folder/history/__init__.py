"""The past of a run, from the events in its journal alone.

- `core_replay` gives the events to a core again, from the beginning or the last checkpoint; the others use it.
- `resume` continues an interrupted run. `rewind` takes a running playback back to an earlier stamp.
- `replay` shows a run to sinks again. `time_travel` gives the map at a moment, and changes between two.
- `recorded` and `track_histories` give decisions and reasons, for `explain` and the viewer.
"""
