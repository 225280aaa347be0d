import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.ports import Accounting, Interruptible, Seekable, SourceAround, account_of, interrupt, num_seeks
from players import open_source
from players.playback import PlaybackClock, PlayedSource


class Able(SceneSource):
    """A source with every ability."""

    num_seeks = 3
    was_interrupted = False

    def interrupt(self):
        self.was_interrupted = True

    def account(self):
        return self

    def as_dict(self):
        return {"used": 8}


@pytest.mark.parametrize("depth", [0, 1, 2])
def test_abilities_are_those_of_the_innermost_source(depth):
    able, bare = Able(), SceneSource()
    around_able, around_bare = able, bare
    for _ in range(depth):
        around_able, around_bare = SourceAround(around_able), SourceAround(around_bare)
    assert num_seeks(around_able) == 3
    assert account_of(around_able).as_dict() == {"used": 8}
    interrupt(around_able)
    assert able.was_interrupted
    assert num_seeks(around_bare) == 0
    assert account_of(around_bare) is None
    interrupt(around_bare)


def test_a_source_without_abilities_has_none_of_them():
    assert not isinstance(SceneSource(), Accounting | Interruptible | Seekable)


def test_a_log_keeps_an_account_and_can_be_sought_in(short_log):
    log = open_source(short_log)
    assert isinstance(log, Accounting)
    clock = PlaybackClock()
    played = PlayedSource(log, clock)
    assert isinstance(played, Seekable)
    frames = played.frames()
    next(frames)
    clock.seek(1.0, relative=True)
    next(frames)
    assert num_seeks(played) == num_seeks(SourceAround(played)) == played.ledger()["seeks"] == 1
    played.close()
