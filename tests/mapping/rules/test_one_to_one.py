from hickory_stream.mapping.rules.association import one_to_one


def test_the_best_pairs_come_first_and_take_both_members():
    assert one_to_one([(1, 7), (1, 8), (2, 7), (2, 8), (3, 9)], of_one_kind=False) == [(1, 7), (2, 8), (3, 9)]
    ranked = [(1, 2), (2, 3), (4, 1), (4, 3)]
    assert one_to_one(ranked, of_one_kind=True) == [(1, 2), (4, 3)]
    assert one_to_one(ranked, of_one_kind=False) == [(1, 2), (2, 3), (4, 1)]
