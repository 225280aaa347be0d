from players.live.live_log import ClockOffset

SECOND = 1_000_000_000


def test_the_offset_is_that_of_the_quickest_message():
    offset = ClockOffset()
    for i in range(100):
        stamp_ns = 1000 * SECOND + i * SECOND // 30
        offset.add(stamp_ns + 120 * SECOND + (i * 7919 % 50) * 1_000_000, stamp_ns)
    assert offset.offset_ns == 120 * SECOND
    assert offset.num_steps == 0


def test_a_restart_or_set_clock_is_a_step_and_a_slow_link_is_not():
    offset = ClockOffset()
    now_ns = 10_000 * SECOND
    for i in range(30):
        offset.add(now_ns + i * SECOND, now_ns + i * SECOND)
    for i in range(30):  # the link is 20 s behind for a while
        offset.add(now_ns + (50 + i) * SECOND, now_ns + (30 + i) * SECOND)
    assert (offset.num_steps, offset.offset_ns) == (0, 0)
    offset.add(now_ns + 81 * SECOND, 3 * SECOND)  # a stamp that is off alone
    assert offset.num_steps == 0
    for i in range(5):
        offset.add(now_ns + (82 + i) * SECOND, (1 + i) * SECOND)
    assert (offset.num_steps, offset.offset_ns) == (1, now_ns + 81 * SECOND)
    offset.add(now_ns, 0)  # never set
    assert offset.num_steps == 1
