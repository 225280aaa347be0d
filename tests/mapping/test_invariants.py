import logging
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
import numpy as np
import pytest
from hickory_stream.errors import InvariantError
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.submaps import SubmapConfig
from hickory_stream.mapping.invariants import INVARIANTS, validate
from hickory_stream.mapping.map_state import PendingFeatures
from hickory_stream.mapping.rules.lifecycle import LifecycleConfig
from hickory_stream.mapping.rules.merge_history import Join, Past
from hickory_stream.mapping.rules.merging import MergeConfig, VoteBook, VoteRow, Votes
from hickory_stream.mapping.rules.shape_requests import RequestConfig
from hickory_stream.mapping.rules.splitting import SplitCandidate, TrackSplitConfig
from hickory_stream.records import Phase
from tests.mapping.mapping_fixtures import VOXEL_M, box_surface, drive, keyframe, observation, space

ROOT = Path(__file__).resolve().parent.parent.parent
CONFIG = MappingConfig(
    voxels=Lattice(object_m=VOXEL_M), lifecycle=LifecycleConfig(confirm_s=1.0), merge=MergeConfig(min_together_s=1.5),
    split=TrackSplitConfig(min_apart_s=4.0), requests=RequestConfig(first_sightings=2),
    submaps=SubmapConfig(travel_m=3.0),
)  # fmt: skip
LEFT, RIGHT, FAR = (box_surface((x, 0, 0.1)) for x in (0.0, 0.2, 1.5))
WHOLE = box_surface((0.1, 0, 0.1), (0.4, 0.2, 0.2))
FLOOR = np.stack(np.meshgrid(np.arange(-1, 1, 0.05), np.arange(-1, 1, 0.05), [0.0]), axis=-1).reshape(-1, 3)


@cache
def driven():
    """The state of a core with two tracks, one of which has taken in a third; a candidate, shape jobs, submaps."""
    core = MapperCore(CONFIG)
    floor, free = (keys_of_points(FLOOR + np.array([0, 0, z]), CONFIG.voxels.space_m) for z in (0.02, 0.6))
    seen = space(structure=floor, free=free, floor_z_m=0.0)
    apart = [observation(0, LEFT), observation(1, RIGHT), observation(2, FAR)]
    for i in range(3):
        drive(core, [keyframe(i, apart, seen=seen)])
    for i in range(3, 8):
        drive(core, [keyframe(i, [observation(0, WHOLE), observation(1, FAR)], seen=seen)])
    # Half a circle of 3 m: a submap ends on the way.
    drive(core, [keyframe(8, apart, seen=seen, angle_rad=1.5), keyframe(9, apart, seen=seen, angle_rad=3.0)])
    core.handle(keyframe(10, apart, seen=seen, angle_rad=3.0))
    return core.state()


@pytest.fixture
def state():
    """A whole state, with something of every part."""
    found = MapperCore.from_state(CONFIG, driven())._state
    assert sorted(found.tracks) == [1, 3]
    assert found.tracks[1].merged_ids == (2,)
    assert found.absorbed.keys() == {1}
    assert found.split_candidates.keys() == {1}
    assert len(found.submaps.states) > 1
    assert len(found.submaps.owned)
    assert all(track.shape_state.open_ticket is not None for track in found.tracks.values())
    found.votes = found.votes.plus([(1, 3)], apart_ns=1)
    validate(found)
    return found


def track_with(state, **changes):
    state.tracks[1] = replace(state.tracks[1], **changes)


def job(state, ticket):
    track_with(state, shape_state=replace(state.tracks[1].shape_state, open_ticket=ticket))


def submaps_with(state, **changes):
    state.submaps = replace(state.submaps, **changes)


def space_with(state, **changes):
    submaps_with(state, space=replace(state.submaps.space, **changes))


def candidate_of(state, host):
    state.split_candidates[host] = (
        SplitCandidate(cloud=state.tracks[3].cloud, frame_index=1, sightings=1, apart_ns=1),
    )


def pending_of_nobody(state):
    view = replace(state.tracks[1].views[0], object_id=2)
    state.pending = PendingFeatures(frame_index=10, candidates={0: view}, object_ids=(1,))


def join_with(state, far_id):
    far = replace(state.tracks[1], id=far_id)
    past = Past(votes={}, absorbed=(), joins=())
    return Join(far=far, past=past, at=np.zeros(3), near=None, united=state.tracks[1], stamp_ns=0)


def backwards(state):
    cloud = state.tracks[1].cloud
    turned = replace(cloud, keys=cloud.keys[::-1], points=cloud.points[::-1])
    track_with(state, cloud=turned, solid=turned)


def half_of(state):
    cloud = state.tracks[1].cloud
    half = replace(cloud, points=cloud.points[: len(cloud.points) // 2])
    candidate_of(state, 1)
    (candidate,) = state.split_candidates[1]
    state.split_candidates[1] = (replace(candidate, cloud=half),)


DAMAGE = [
    ("the key of every track is its id", lambda s: track_with(s, id=7)),
    ("ids and tickets in use are below the next ones to be given", lambda s: setattr(s, "next_id", 3)),
    ("ids and tickets in use are below the next ones to be given", lambda s: job(s, 99)),
    ("a merged track is removed", lambda s: track_with(s, merged_ids=(2, 3))),
    ("a track is merged into only one other", lambda s: s.tracks.update({3: replace(s.tracks[3], merged_ids=(2,))})),
    ("a shape job belongs to only one track", lambda s: job(s, s.tracks[3].shape_state.open_ticket or 0)),
    ("a tentative track has no shape job", lambda s: track_with(s, phase=Phase.TENTATIVE)),
    ("the solid part and the bounds of a track", lambda s: track_with(s, solid=s.tracks[3].solid)),
    ("the solid part and the bounds of a track", lambda s: track_with(s, bounds=s.tracks[3].bounds)),
    ("a cloud has each voxel once, in order", backwards),
    ("a cloud has each voxel once, in order", half_of),
    ("no track was seen later than the clock", lambda s: setattr(s, "clock_ns", 0)),
    ("a view belongs to the track that holds it", lambda s: track_with(s, best_view=s.tracks[3].best_view)),
    ("a view belongs to the track that holds it", pending_of_nobody),
    ("the pixels of all views in use are kept", lambda s: s.kept_views.pop()),
    ("no pixels of unused views are kept", lambda s: s.kept_views.add("000099-000")),
    ("votes are of pairs of tracks", lambda s: setattr(s, "votes", VoteBook(rows={1: VoteRow({3: Votes()})}))),
    ("votes are of pairs of tracks", lambda s: setattr(s, "votes", VoteBook().plus([(1, 2)]))),
    ("split candidates and absorbed tracks belong to an existing track", lambda s: candidate_of(s, 2)),
    (
        "split candidates and absorbed tracks belong to an existing track",
        lambda s: s.absorbed.update({2: s.absorbed.pop(1)}),
    ),
    ("an absorbed track is listed", lambda s: s.absorbed.update({3: s.absorbed.pop(1)})),
    ("a track is absorbed by only one other", lambda s: s.absorbed.update({1: s.absorbed[1] * 2})),
    ("joins belong to an existing track", lambda s: s.joins.update({2: (join_with(s, far_id=2),)})),
    ("joins belong to an existing track", lambda s: s.joins.update({1: (join_with(s, far_id=3),)})),
    ("submaps are numbered in order and have rigid poses", lambda s: submaps_with(s, states=s.submaps.states[::-1])),
    ("submaps are numbered in order and have rigid poses", lambda s: submaps_with(s, first=9)),
    ("a track is last seen in its own submap", lambda s: track_with(s, seen_in=7)),
    ("a track is elsewhere if and only if", lambda s: s.elsewhere.update(s.tracks)),
    ("a voxel is owned by only one closed submap", lambda s: submaps_with(s, owned=s.submaps.owned[::-1])),
    ("a voxel is owned by only one closed submap", lambda s: submaps_with(s, owners=s.submaps.owners + 9)),
    (
        "if decisions are made against the open submap alone",
        lambda s: submaps_with(s, first=s.submaps.open_id, owned=s.submaps.owned[:0], owners=s.submaps.owners[:0]),
    ),
    ("the voxels of an observed space are in order", lambda s: space_with(s, free=s.submaps.space.free[::-1])),
    ("the voxels of an observed space are in order", lambda s: space_with(s, free=s.submaps.space.surface)),
]


@pytest.mark.parametrize(("name", "damage"), DAMAGE, ids=[f"{i}: {name}" for i, (name, _) in enumerate(DAMAGE)])
def test_a_broken_state_is_refused_by_the_name_of_its_defect(state, name, damage):
    if "kept" in name:
        state.pending = None
        state.kept_views &= state.view_names()
        validate(state)
    damage(state)
    with pytest.raises(InvariantError, match=f"after keyframe 11: {name}.*; found "):
        validate(state)


def test_a_new_map_is_whole_and_every_invariant_is_broken_by_one():
    broken = [[name for name in INVARIANTS if name.startswith(begin)] for begin, _ in DAMAGE]
    assert all(len(names) == 1 for names in broken)
    assert {names[0] for names in broken} == INVARIANTS.keys()
    MapperCore(CONFIG).validate()


@pytest.mark.parametrize("level", [logging.DEBUG, logging.WARNING])
def test_the_core_checks_its_state_where_debug_is_logged(level, caplog):
    core = MapperCore(CONFIG)
    core._state.votes = VoteBook().plus([(8, 9)])
    with caplog.at_level(level, logger="hickory_stream"):
        if level == logging.DEBUG:
            with pytest.raises(InvariantError, match="votes are of pairs of tracks"):
                core.handle(keyframe(0, []))
        else:
            core.handle(keyframe(0, []))


@pytest.mark.parametrize("options", [["--debug"], []], ids=["with --debug", "without"])
def test_play_checks_with_debug_only_and_ends_in_one_line(options, tmp_path):
    # In a process of its own, where nobody has set up the logging before the command line does.
    script = (
        "import sys\n" "from hickory_stream.cli import main\n" "from hickory_stream.mapping import invariants\n"
        "invariants.INVARIANTS['it is on purpose'] = lambda state: iter(['this'])\n" "sys.exit(main(sys.argv[1:]))\n"
    )  # fmt: skip
    play = ["play", "recordings/demo.mcap", "--frames", "2", "--out", str(tmp_path / "map"), "--viewer", "none"]
    command = [sys.executable, "-c", script, *play, *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    # Two frames confirm no object, which is status 3.
    assert done.returncode == (1 if options else 3), done.stderr
    told = "hickory-stream: the map's state is broken after keyframe 0: it is on purpose; found this"
    assert (told in done.stderr.splitlines()) == bool(options)
