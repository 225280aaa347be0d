"""One alignment of a large simulated pair in a process of its own: its time and memory."""

import resource
import time
from dataclasses import dataclass

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment
from tools.benchmarks.common.processes import in_child
from tools.evaluation.alignment_error import error_of
from tools.evaluation.simulated_maps.simulate import Difficulty, SimulationConfig, simulate_pair
from tools.evaluation.simulated_maps.trial import overlap_b


@dataclass(frozen=True, kw_only=True, slots=True)
class LargePair:
    """Whether a pair was aligned rightly, in how many processor seconds, and the peak memory of the process."""

    is_found: bool
    seconds: float
    peak_mb: float


def large_pair(seed: int, num_objects: int, difficulty: Difficulty) -> LargePair:
    """Return the costs of one alignment; a quarter of the objects is in both maps."""
    found: LargePair = in_child(_measured, seed, num_objects, difficulty)
    return found


def _measured(seed: int, num_objects: int, difficulty: Difficulty) -> LargePair:
    # A small pair first, which loads the kernels.
    small = simulate_pair(SimulationConfig(num_objects=20), 0)
    align(small.map_a, small.map_b)
    pair = simulate_pair(SimulationConfig(num_objects=num_objects, difficulty=difficulty), seed)
    started = time.process_time()
    answer = align(pair.map_a, pair.map_b)
    seconds = time.process_time() - started
    is_found = isinstance(answer, Alignment) and error_of(answer.a_from_b, pair.a_from_b, overlap_b(pair)).is_success
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return LargePair(is_found=is_found, seconds=seconds, peak_mb=peak_mb)
