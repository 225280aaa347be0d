import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.perception.regions.contacts import Contacts, support_contacts_of
from tests.strategies import seeds

FOOT = 0.35


@given(seeds, st.integers(0, 60), st.integers(1, 5))
def test_the_carrier_is_counted_below_the_outline_of_the_foot(seed, num_contacts, count):
    rng = np.random.default_rng(seed)
    shape = (8, 9)
    heights, level = rng.random(shape).astype(np.float32), rng.random(shape) < 0.5
    pieces = np.append(rng.permutation(count), count)
    here, there, cut = (rng.integers(0, count + 1, n).astype(np.int32) for n in (num_contacts, num_contacts, 12))
    here_px, there_px, cut_px = (rng.integers(0, heights.size, n) for n in (num_contacts, num_contacts, 12))
    is_below, touches, nearer = rng.random((3, num_contacts)) < 0.6
    contacts = Contacts(
        here=here, there=there, here_px=here_px, there_px=there_px, is_below=is_below, touches=touches, nearer=nearer,
        cut=cut, cut_px=cut_px,
    )  # fmt: skip
    support = support_contacts_of(contacts, pieces, heights, level)
    z, flat = heights.ravel(), level.ravel()
    for piece in range(count):
        outer = is_below & (pieces[here] == piece) & (pieces[there] != piece)
        edge = pieces[cut] == piece
        outline = np.concatenate([z[here_px[outer]], z[cut_px[edge]]]).astype(np.float64)
        foot = (1 - FOOT) * outline.min() + FOOT * outline.max() if len(outline) else 0.0
        at_foot = outer & (z[here_px] <= foot)
        assert support.outline[piece] == at_foot.sum() + (z[cut_px[edge]] <= foot).sum()
        assert support.free[piece] == (at_foot & ~touches & ~nearer).sum()
        on = pieces[there[at_foot & touches & flat[there_px]]]
        assert np.array_equal(support.on[piece], np.bincount(on, minlength=count + 1))
