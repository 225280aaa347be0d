import math
from dataclasses import replace
from functools import reduce
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.mapping.derived import ViewUse
from hickory_stream.mapping.entities.track_table import TrackTable
from hickory_stream.mapping.entities.views import (
    CUT_FACTOR,
    ViewConfig,
    better,
    covers_better,
    s_score,
    score,
    score_bound,
    sector_of,
    usefulness,
)
from tests.mapping.mapping_fixtures import box_surface, track, view
from tests.strategies import unit_share, views

CONFIG = ViewConfig()
STRATEGIES = ("s_score", "initial", "max_area", "max_box", "max_volume")
scored = st.builds(lambda v, s: replace(v, score=s), views(), st.one_of(st.none(), st.sampled_from([0.0, 0.1, 0.2])))


@pytest.mark.parametrize(
    ("variance", "r_area", "r_depth", "expected"),
    [
        # ln(1.5) * 0.25^0.3 * 0.64^0.5: 0.405465 * 0.659754 * 0.8
        (0.5, 0.25, 0.64, 0.214006),
        # ln 2 alone: the whole image, all of it with depth, and the largest variance.
        (1.0, 1.0, 1.0, math.log(2)),
        (0.0, 0.5, 0.5, 0.0),
        (0.5, 0.0, 0.9, 0.0),
        (0.5, 0.5, 0.0, 0.0),
    ],
)
def test_s_is_the_papers_formula(variance, r_area, r_depth, expected):
    config = ViewConfig(alpha=0.3, beta=0.5, feature_norm2=1.0)
    assert s_score(variance, r_area, r_depth, config) == pytest.approx(expected, abs=1e-6)


def test_a_view_cut_by_the_border_is_worth_less():
    whole = replace(view(1), is_cut=False)
    cut = replace(whole, is_cut=True)
    assert score(cut, 0.3, CONFIG) == pytest.approx(CUT_FACTOR * score(whole, 0.3, CONFIG))
    assert score(cut, 0.3, ViewConfig(strategy="max_area")) == score(whole, 0.3, ViewConfig(strategy="max_area"))


@given(views(), unit_share, st.sampled_from(STRATEGIES))
def test_no_feature_variance_lifts_the_score_above_the_bound(seen, variance, strategy):
    config = ViewConfig(strategy=strategy)
    assert score(seen, variance, config) <= score_bound(seen, config)


@given(st.lists(st.tuples(views(), unit_share), min_size=1, max_size=8), st.sampled_from(STRATEGIES))
def test_each_strategy_picks_what_its_name_says(seen, strategy):
    config = ViewConfig(strategy=strategy)
    seen = [(replace(v, frame_index=i), variance) for i, (v, variance) in enumerate(seen)]
    judged = [replace(v, score=score(v, variance, config)) for v, variance in seen]
    best = reduce(better, judged)
    i = best.frame_index
    width, height = ([v.box_px[k + 2] - v.box_px[k] for v in judged] for k in (0, 1))
    match strategy:
        case "s_score":
            values = [
                (0.7 if v.is_cut else 1.0) * math.log(1 + 768 * s) * v.r_area**0.3 * v.r_depth**0.5 for v, s in seen
            ]
            assert values[i] == pytest.approx(max(values), rel=1e-12)
        case "initial":
            assert i == 0
        case "max_area":
            assert best.r_area == max(v.r_area for v in judged)
        case "max_box":
            assert width[i] * height[i] == max(w * h for w, h in zip(width, height, strict=True))
        case "max_volume":
            assert best.box_volume_m3 == max(v.box_volume_m3 for v in judged)


@given(scored, scored, scored)
def test_the_better_view_does_not_depend_on_the_order(a, b, c):
    def key(seen):
        return (seen.score, seen.frame_index, seen.box_px)

    if len({key(v)[1:] for v in (a, b, c)}) == 3 and None not in (a.score, b.score, c.score):
        assert key(better(a, b)) == key(better(b, a))
        assert key(better(better(a, b), c)) == key(better(a, better(b, c)))


def test_the_earlier_of_equal_views_and_any_scored_one_is_better():
    earlier, later = view(3, score=0.2), view(8, score=0.2)
    assert better(earlier, later) is earlier
    assert better(later, earlier) is earlier
    bare, worst = view(0), view(9, score=0.0)
    assert better(bare, worst) is worst
    assert better(worst, bare) is worst
    assert better(bare, None) is bare
    assert better(None, bare) is bare
    assert better(None, None) is None


def test_eight_directions_around_an_object_are_eight_sectors():
    center = np.array([3.0, -2.0, 0.5])
    sectors = set()
    for i in range(8):
        angle = (i + 0.5) * math.pi / 4
        eye = center + 2 * np.array([math.cos(angle), math.sin(angle), 0.7])
        sectors.add(sector_of(replace(view(i), world_from_camera=from_rotation_translation(np.eye(3), eye)), center))
    assert sectors == set(range(8))


@given(st.floats(-math.pi, math.pi), st.floats(0, 5))
def test_every_direction_has_a_sector_whatever_the_height(angle, height):
    eye = np.array([math.cos(angle), math.sin(angle), height])
    pose = from_rotation_translation(np.eye(3), eye)
    assert sector_of(replace(view(0), world_from_camera=pose), np.zeros(3)) in range(8)


def test_a_cut_shallow_or_small_view_is_less_useful():
    good = view(0, r_area=0.2, r_depth=0.9)
    for worse in (replace(good, is_cut=True), replace(good, r_depth=0.3), replace(good, r_area=0.02)):
        assert usefulness(worse) < usefulness(good)


@given(views(), views())
def test_a_kept_view_yields_only_to_a_clearly_better_one(a, b):
    assert covers_better(a, None)
    assert not (covers_better(a, b) and covers_better(b, a))
    assert not covers_better(a, a)


def test_a_view_placed_before_counting_is_unused():
    bare = track(1, box_surface((0, 0, 0.1)))
    first, second, third = (view(k) for k in (1, 2, 3))
    tracks, elsewhere, use = TrackTable({1: replace(bare, best_view=first)}), TrackTable({}), ViewUse()
    kept = {first.name}
    assert use.unused(tracks, elsewhere, {}, {}, kept) == []
    for now in (second, third):
        tracks[1] = replace(bare, best_view=now)
        kept.add(now.name)
        use.ask_for(now.name)
    assert use.unused(tracks, elsewhere, {}, {}, kept) == sorted([first.name, second.name])
    assert use.unused(tracks, elsewhere, {}, {}, {third.name}) == []
