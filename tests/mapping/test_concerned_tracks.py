import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.events import FrameObserved, SourceEnded
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.voxels import keys_of_points, sorted_unique
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities import submaps
from hickory_stream.mapping.entities.submaps import SubmapConfig
from hickory_stream.mapping.rules.lifecycle import LifecycleConfig
from hickory_stream.mapping.steps import ageing
from tests.mapping.mapping_fixtures import SECOND_NS, VOXEL_M, box_surface, drive, observation, space

CONFIG = MappingConfig(
    voxels=Lattice(object_m=VOXEL_M),
    lifecycle=LifecycleConfig(confirm_s=1.0, dormant_s=2.0, archive_s=9.0, tentative_s=3.0, phantom_s=2.0),
    submaps=SubmapConfig(travel_m=9.0, searches_loops=False),
)
FAR_M = 14.0
# (which of four places, which of its things are seen, what of it is seen as a wall or as free, seconds until then)
LOOKS = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 7), st.sampled_from(["wall", "free", "both"]), st.sampled_from([1, 4])),
    min_size=4,
    max_size=14,
)
THINGS = ((0.0, (0.2, 0.2, 0.2)), (0.23, (0.2, 0.2, 0.3)), (1.0, (0.6, 0.04, 0.6)))


def keyframes(looks):
    events, stamp_ns = [], 0
    for i, (place, which, what, seconds) in enumerate(looks):
        stamp_ns += seconds * SECOND_NS
        x_m = FAR_M * place
        things = [
            box_surface((x_m + off, 0, size[2] / 2 + 0.02), size)
            for k, (off, size) in enumerate(THINGS)
            if which >> k & 1
        ]
        across = np.mgrid[-1:2:0.05, 0.0:1.0:0.05].reshape(2, -1)
        wall = np.stack([x_m + across[0], np.full(across.shape[1], 0.02), across[1]], axis=1)
        room = wall - np.array([0.0, 0.05 * (i % 3), 0.0])
        keys = [sorted_unique(keys_of_points(points.astype(np.float32), 0.05)) for points in (wall, room)]
        events.append(
            FrameObserved(
                frame_index=i, stamp_ns=stamp_ns,
                world_from_camera=from_rotation_translation(np.eye(3), np.array([x_m, -2.0 - 0.1 * i, 0.5])),
                observations=tuple(observation(k, points) for k, points in enumerate(things)),
                space=space(
                    structure=keys[0] if what != "free" else keys[0][:0],
                    free=keys[1] if what != "wall" else keys[1][:0], floor_z_m=0.0,
                ),
            )
        )  # fmt: skip
    return events


def mapped(looks):
    core = MapperCore(CONFIG)
    drive(core, keyframes(looks))
    core.validate()
    before_end = map_digest(core.snapshot())
    core.handle(SourceEnded(stamp_ns=1_000 * SECOND_NS))
    return before_end + map_digest(core.snapshot()), core


class Everything(ageing.Concerned):
    """All tracks, as if every keyframe concerned them."""

    def __init__(self, state, event, config):
        state.stirred = set(state.tracks)
        super().__init__(state, event, config)


@settings(max_examples=25, deadline=None)
@given(LOOKS)
def test_what_a_keyframe_does_not_concern_would_not_have_changed(looks):
    found, core = mapped(looks)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hickory_stream.mapping.steps.ageing.Concerned", Everything)
        # As if all space were always at hand.
        patch.setattr(submaps, "looking_at", lambda known, *_: known)
        patch.setattr("hickory_stream.mapping.steps.submaps.looking_at", lambda known, *_: known)
        everything, whole = mapped(looks)
    assert found == everything
    for a, b in zip(core.submaps, whole.submaps, strict=True):
        for name in ("free", "hidden_free", "surface", "hits", "misses"):
            assert np.array_equal(getattr(a.space, name), getattr(b.space, name)), (a.id, name)
