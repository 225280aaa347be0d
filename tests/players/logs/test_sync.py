from hypothesis import given
from hypothesis import strategies as st
from players.logs.synchronizer import (
    DISORDER_NS,
    HORIZON_NS,
    Leftover,
    Pair,
    Stamped,
    default_tolerance_ns,
    pair_arriving,
    pair_nearest,
)

MS = 1_000_000
stamps = st.lists(st.integers(0, 3_000).map(lambda ms: ms * MS), unique=True, max_size=40).map(sorted)
tolerances = st.integers(0, 120).map(lambda ms: ms * MS)


def _images(colors, depths):
    images = [Stamped("color", s, ("c", s)) for s in colors] + [Stamped("depth", s, ("d", s)) for s in depths]
    return sorted(images, key=lambda image: image.stamp_ns)


def _pairs(images, tolerance_ns):
    matches = pair_nearest(images, tolerance_ns)
    return [(match.stamp_ns, match.depth_stamp_ns) for match in matches if isinstance(match, Pair)]


@given(stamps, stamps, tolerances)
def test_every_image_is_in_one_near_pair_in_order_or_left_over(colors, depths, tolerance):
    seen = []
    for match in pair_nearest(_images(colors, depths), tolerance):
        seen += [match.item] if isinstance(match, Leftover) else [match.color, match.depth]
    assert sorted(seen) == sorted([("c", s) for s in colors] + [("d", s) for s in depths])
    pairs = _pairs(_images(colors, depths), tolerance)
    assert all(abs(c - d) <= tolerance for c, d in pairs)
    assert [c for c, _ in pairs] == sorted(c for c, _ in pairs)
    assert [d for _, d in pairs] == sorted(d for _, d in pairs)


@given(stamps, stamps, tolerances)
def test_images_that_are_each_others_nearest_are_paired(colors, depths, tolerance):
    pairs = set(_pairs(_images(colors, depths), tolerance))
    for c in colors:
        for d in depths:
            gap = abs(c - d)
            is_nearest = all(abs(other - d) > gap for other in colors if other != c) and all(
                abs(other - c) > gap for other in depths if other != d
            )
            if gap <= tolerance and is_nearest:
                assert (c, d) in pairs


@given(stamps, stamps, tolerances, st.randoms(use_true_random=False), st.integers(0, 800))
def test_the_order_of_arrival_does_not_matter(colors, depths, tolerance, random, skew_ms):
    ordered = _images(colors, depths)

    def arrival(image):
        jitter = random.uniform(0, DISORDER_NS - 1)
        return image.stamp_ns + jitter + (skew_ms * MS if image.stream == "depth" else 0)

    assert _pairs(sorted(ordered, key=arrival), tolerance) == _pairs(ordered, tolerance)


@given(stamps, stamps, tolerances)
def test_colour_and_depth_are_treated_alike(colors, depths, tolerance):
    there = _pairs(_images(colors, depths), tolerance)
    assert there == [(c, d) for d, c in _pairs(_images(depths, colors), tolerance)]


def test_nearest_images_are_paired_and_of_equals_the_earlier():
    colors = [i * 33 * MS for i in range(30)]
    depths = [i * 99 * MS + 5 * MS for i in range(10)]
    assert _pairs(_images(colors, depths), 50 * MS) == [(i * 99 * MS, i * 99 * MS + 5 * MS) for i in range(10)]
    assert _pairs(_images([0, 40 * MS], [20 * MS]), 50 * MS) == [(0, 20 * MS)]
    assert default_tolerance_ns([0, 33, 66, 99], [0, 100, 200, 300]) == 50
    assert default_tolerance_ns([0, 100, 200, 9000, 9100], [0, 100, 200]) == 50


def test_a_silent_stream_does_not_make_the_other_pile_up():
    held, most = set(), 0

    def images():
        yield Stamped("depth", 0, 0)
        for i in range(1, 200):
            held.add(i)
            yield Stamped("color", i * 33 * MS, i)

    for match in pair_nearest(images(), 15 * MS):
        if isinstance(match, Leftover):
            held.discard(match.item)
        most = max(most, len(held))
    assert most <= HORIZON_NS // (33 * MS) + 2


def test_an_image_after_its_neighbours_were_decided_is_late():
    images = [Stamped(stream, i * 100 * MS, i) for i in range(20) for stream in ("color", "depth")]
    matches = list(pair_nearest([*images, Stamped("color", 50 * MS, "late")], 50 * MS))
    assert [match.item for match in matches if isinstance(match, Leftover) and match.is_late] == ["late"]
    assert sum(isinstance(match, Pair) for match in matches) == 20


def test_live_images_of_one_stamp_are_paired_at_once():
    def image(stream, at_ms):
        return Stamped(stream, at_ms * 1_000_000, f"{stream}{at_ms}")

    def come(*sent):
        """Return what has been decided after each image."""
        decided, seen = [], []

        def feed():
            for item in sent:
                seen.append(len(decided))
                yield item

        decided.extend(pair_arriving(feed(), 16_000_000, is_live=True))
        return [*seen, decided]

    *seen, decided = come(*[image(stream, at) for at in (0, 33, 66) for stream in ("color", "depth")], None)
    assert seen == [0, 0, 1, 1, 2, 2, 3]
    assert [match and match.stamp_ns // 1_000_000 for match in decided] == [0, 33, 66, None]
    # Depth that was 33 ms late once costs a pair, and is given that time from then on.
    out_of_order = [image("color", 0), image("depth", 33), image("color", 33), image("depth", 0)]
    again = [image("color", 66), image("depth", 99), image("color", 99), image("depth", 66)]
    *_, decided = come(*out_of_order, *again)
    assert [match.stamp_ns // 1_000_000 for match in decided if isinstance(match, Pair)] == [33, 66, 99]
    assert [match.is_late for match in decided if isinstance(match, Leftover)] == [False, True]
