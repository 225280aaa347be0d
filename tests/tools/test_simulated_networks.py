import numpy as np
import pytest
from hickory_stream.errors import RecordingError
from tools.evaluation.masks.simulated_networks import LADDER, OTHER_RATES, WITHOUT_HABITS, SimulatedNetwork, simulator

SIMULATOR = """
from dataclasses import dataclass

@dataclass(frozen=True)
class MaskErrors:
    missed_small: float = 0.4
    missed_medium: float = 0.2
    missed_large: float = 0.1
    whole_in_pieces: float = 0.5
    part_shown: float = 0.7
    merged_per_thing: float = 0.2
    room_piece_shown: float = 0.8

class Habits:
    def __init__(self, seed, errors):
        self.seed = seed

def simulated_masks(instances, rgb, rng, errors, habits):
    mask = instances == 1
    mask[rng.integers(len(mask))] = True
    return [(mask, errors.missed_small + 10 * errors.room_piece_shown + 100 * (habits is not None))]

def simulated_classes(instances, is_structure, rng):
    return is_structure
"""
SHOWN = np.repeat(np.array([0, 1, 2], np.int32), 100).reshape(3, 100).T.repeat(4, axis=1)


class Images:
    def at(self, stamp_ns):
        return SHOWN


@pytest.fixture(scope="module")
def made_by(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shared")
    (folder / "simulated_masks.py").write_text(SIMULATOR)
    return simulator(folder)


def score(made_by, rung):
    return SimulatedNetwork(made_by, Images(), rung, 0).masks(None)[0][0].score


def test_the_first_rung_is_true_and_each_adds_errors(made_by):
    found = {rung: round(score(made_by, rung), 6) for rung in (*LADDER[1:], WITHOUT_HABITS, OTHER_RATES)}
    assert found == {
        "outlines": 0, "parts": 0, "merges": 0, "misses": 0.4, "room": 8.4, "habits": 108.4, "classes": 108.4,
        "no_habits": 8.4, "other_rates": 109.6,
    }  # fmt: skip
    masks, _ = SimulatedNetwork(made_by, Images(), LADDER[0], 0).masks(None)
    assert [mask.box_px for mask in masks] == [(4, 0, 8, 100), (8, 0, 12, 100)]


def test_masks_follow_from_the_stamp_in_any_order(made_by):
    network, found = SimulatedNetwork(made_by, Images(), "room", 7), {}
    for stamp in (1, 2, 1):
        network.stamp_ns = stamp
        found.setdefault(stamp, []).append(network.masks(None)[0][0].mask.tobytes())
    assert found[1][0] == found[1][1] != found[2][0]


def test_without_a_simulator_one_line_says_so(tmp_path):
    with pytest.raises(RecordingError, match=r"simulated_masks\.py is not there"):
        simulator(tmp_path)
