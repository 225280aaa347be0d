import numpy as np
from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment, NoAlignment, Refusal
from hickory_stream.alignment.object_map import taken
from hickory_stream.merging.joining import JoiningConfig, aligned_to_join
from tools.evaluation.simulated_maps.simulate import SimulationConfig, simulate_pair


def test_maps_are_joined_only_beyond_chance():
    pair = simulate_pair(SimulationConfig(difficulty="easy"), 3)
    answer = align(pair.map_a, pair.map_b)
    assert isinstance(answer, Alignment)
    assert answer.log10_chance < JoiningConfig().max_log10_chance
    joined = aligned_to_join(pair.map_a, pair.map_b)
    assert isinstance(joined, Alignment)
    assert joined.a_from_b.tobytes() == answer.a_from_b.tobytes()
    surer = JoiningConfig(max_log10_chance=answer.log10_chance - 0.1)
    too_weak = aligned_to_join(pair.map_a, pair.map_b, surer)
    assert isinstance(too_weak, NoAlignment)
    assert too_weak.refusal is Refusal.CHANCE
    assert too_weak.reason.startswith(f"{len(answer.pairs)} pairs agree, but less than 0.000000001 such sets of pairs")


def test_what_align_refuses_is_refused_for_its_reason():
    pair = simulate_pair(SimulationConfig(difficulty="easy"), 3)
    two = taken(pair.map_b, np.arange(2))
    nothing = aligned_to_join(pair.map_a, two)
    assert isinstance(nothing, NoAlignment)
    assert nothing.refusal is Refusal.TOO_FEW_OBJECTS
