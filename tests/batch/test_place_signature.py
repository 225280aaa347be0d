import numpy as np
import pytest
from hickory_stream.alignment.object_map import taken
from hickory_stream.batch.place_signature import candidate_pairs, place_signatures
from tools.evaluation.simulated_maps.simulate import FleetMapsConfig, simulate_fleet
from tools.evaluation.simulated_maps.variants import moved_map, random_frame


@pytest.fixture(scope="module")
def fleet():
    return simulate_fleet(FleetMapsConfig(num_maps=24, difficulty="easy"), 101)


def test_maps_with_ten_common_objects_are_found_with_few_queries(fleet):
    asked = set(candidate_pairs(place_signatures(fleet.maps)))
    overlapping = {pair for pair, count in fleet.common.items() if count >= 10}
    assert len(overlapping) >= 5
    assert len(overlapping & asked) >= 0.9 * len(overlapping)
    assert len(asked) <= 3 * len(overlapping)
    assert all(a < b for a, b in asked)


def test_frame_and_order_of_a_map_change_nothing(fleet):
    maps = fleet.maps
    rng = np.random.default_rng(3)
    others = [taken(moved_map(one, random_frame(rng)), rng.permutation(len(one))) for one in maps]
    found, again = (candidate_pairs(place_signatures(both)) for both in (maps, others))
    # What lies at the border of a bin may fall on its other side.
    assert len(set(found) ^ set(again)) <= 1
    assert found


def test_equal_maps_are_a_pair_and_empty_ones_overlap_nothing(fleet):
    empty = taken(fleet.maps[0], np.empty(0, dtype=np.int64))
    one = taken(fleet.maps[0], np.array([0]))
    assert candidate_pairs(place_signatures([empty, one, fleet.maps[1]])) == {}
    assert candidate_pairs(place_signatures([])) == {}
    signatures = place_signatures([fleet.maps[0], fleet.maps[0]])
    assert list(candidate_pairs(signatures)) == [(0, 1)]
    assert signatures[0].num_bytes < 400 * len(fleet.maps[0])
