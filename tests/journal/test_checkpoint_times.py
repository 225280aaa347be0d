from hickory_stream.engine.step_writer import CheckpointTimes


def due(keyframes, searching):
    """Return where a checkpoint is due; `searching` has a 's' for each keyframe with an open search."""
    times = CheckpointTimes(keyframes)
    return "".join("x" if times.is_due(searches=one == "s") else "." for one in searching)


def test_one_is_due_every_so_many_keyframes():
    assert due(3, ".........") == "..x..x..x"
    assert due(1, "...") == "xxx"


def test_one_waits_for_searches_but_not_for_ever():
    assert due(3, "..sss.....") == ".....x..x."
    assert due(3, "ss........") == "..x..x..x."
    assert due(2, "s" * 12) == "...x...x...x"
