"""Whether two maps are aligned surely enough to be made one.

An answer to a person is looked at, and may be wrong now and then. What joins maps is built upon: more is asked. The
null model of `align` has objects at uniform places; furnished rooms resemble one another more than that. Of 90 pairs of
maps of different rooms four were aligned, at 10^-2.9 to 10^-4.2; nine of ten pairs of maps of one room at 10^-8.8 and
less (maps of rooms 300 to 304 and 310 to 314 of `make_recording`, two robots each; the limit was chosen on them).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment, NoAlignment, Refusal

if TYPE_CHECKING:
    from hickory_stream.alignment.align_config import AlignConfig
    from hickory_stream.alignment.object_map import ObjectMap

MAX_LOG10_CHANCE = -6.0


def aligned_to_join(
    map_a: ObjectMap,
    map_b: ObjectMap,
    config: AlignConfig | None = None,
    max_log10_chance: float = MAX_LOG10_CHANCE,
) -> Alignment | NoAlignment:
    """Return what `align` does, but refuse an answer whose expected number of false alarms is larger than 10^this."""
    answer = align(map_a, map_b, config)
    if isinstance(answer, NoAlignment) or answer.log10_chance <= max_log10_chance:
        return answer
    return NoAlignment(
        refusal=Refusal.CHANCE,
        reason=f"{len(answer.pairs)} pairs agree, and 10^{answer.log10_chance:.1f} such sets are expected by chance; "
        f"maps are joined from 10^{max_log10_chance:g} on, `hickory-stream align` answers sooner",
        contradictions=answer.contradictions,
        notes=answer.notes,
    )
