import numpy as np
import pytest
from hickory_stream.alignment.object_map import object_map
from hickory_stream.config import MapperConfig
from hickory_stream.engine import relocalise
from tests.alignment.map_fixtures import furniture, snapshot_of

ITEMS = furniture(12, 1)


class Shown:
    """A mapper whose map has so many objects at each keyframe."""

    extractor_name = ""

    def __init__(self, *counts):
        self.counts = counts

    async def __aenter__(self):
        return self

    async def __aexit__(self, *_):
        pass

    async def run(self, *_, **__):
        for count in self.counts:
            yield snapshot_of(ITEMS[:count], np.eye(4), 2)

    def stop(self):
        pass


@pytest.mark.parametrize(("counts", "confirmed"), [((12, 1, 11), [False, False, True]), ((12, 1), [False, False])])
def test_a_refusal_between_two_poses_that_agree_says_nothing(monkeypatch, counts, confirmed):
    monkeypatch.setattr(relocalise, "Mapper", lambda *_, **__: Shown(*counts))
    stored, told = object_map(snapshot_of(ITEMS, np.eye(4), 1)), []
    relocalise.relocalise(stored, None, MapperConfig(), rate=None, stops_when_found=True, report=told.append)
    assert [one.is_confirmed for one in told] == confirmed
