from hickory_stream.engine.step_writer import CheckpointTimes


def due(keyframes, searching):
    """Return where a checkpoint is due; `searching` has a 's' for each keyframe with an open search."""
    times = CheckpointTimes(keyframes)
    return "".join("x" if times.is_due(searches=one == "s") else "." for one in searching)


def test_one_is_due_every_few_keyframes_and_waits_for_searches():
    assert due(3, ".........") == "..x..x..x"
    assert due(1, "...") == "xxx"
    assert due(3, "..sss.....") == ".....x..x."
    assert due(3, "ss........") == "..x..x..x."
    assert due(2, "s" * 12) == "...x...x...x"
