from hypothesis import given
from hypothesis import strategies as st
from players.logs.timeline import BACKWARDS_NS, FORWARD_NS, Order, Timeline

S = 1_000_000_000


def _placed_ns(stamps_ns):
    timeline = Timeline()
    return [p for i, s in enumerate(stamps_ns) for p in timeline.add(s, i)] + timeline.end()


def _placed(stamps_s):
    return _placed_ns(round(s * S) for s in stamps_s)


def _orders(stamps_s):
    return {p.item: p.order for p in _placed(stamps_s)}


def test_stamps_in_order_are_in_one_epoch():
    placed = _placed([10, 10.1, 10.2])
    assert [(p.item, p.epoch, p.order, p.jump_ns) for p in placed] == [(i, 0, Order.IN_ORDER, 0) for i in range(3)]


def test_a_late_message_and_a_double_are_told_apart():
    orders = _orders([10, 10.2, 10.1, 10.2, 10.3])
    assert orders == {0: Order.IN_ORDER, 1: Order.IN_ORDER, 2: Order.LATE, 3: Order.DUPLICATE, 4: Order.IN_ORDER}


def test_one_wrong_stamp_is_off_and_no_jump():
    for wrong in (0.0, 99999.0):
        placed = _placed([100, 100.1, wrong, 100.2, 100.3])
        assert {p.item: p.order for p in placed}[2] is Order.OFF
        assert {p.epoch for p in placed} == {0}
        assert not any(p.jump_ns for p in placed)


def test_a_looped_log_begins_another_epoch():
    placed = _placed([100, 100.1, 100.2, 50, 50.1, 50.2])
    assert [p.epoch for p in placed] == [0, 0, 0, 1, 1, 1]
    assert placed[3].jump_ns == round(-50.2 * S)
    assert all(p.order is Order.IN_ORDER for p in placed)


def test_a_pause_is_a_jump_forward_in_the_same_epoch():
    placed = _placed([100, 100.1, 200, 200.1])
    assert [(p.epoch, p.jump_ns > 0) for p in placed] == [(0, False), (0, False), (0, True), (0, False)]


def test_a_stream_slower_than_a_jump_is_played():
    placed = _placed([100.0 + 20 * i for i in range(6)])
    assert sum(p.order is Order.OFF for p in placed) <= 1
    assert {p.epoch for p in placed} == {0}


@given(st.lists(st.integers(0, 5 * FORWARD_NS), max_size=40))
def test_every_message_is_placed_exactly_once(stamps_ns):
    assert sorted(p.item for p in _placed_ns(stamps_ns)) == list(range(len(stamps_ns)))


@given(st.lists(st.integers(0, BACKWARDS_NS // 2), min_size=1, max_size=40, unique=True))
def test_disorder_within_half_a_second_is_never_a_jump(stamps_ns):
    assert all(p.order in (Order.IN_ORDER, Order.LATE) and p.epoch == 0 for p in _placed_ns(stamps_ns))
