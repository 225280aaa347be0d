"""Whether two maps are aligned surely enough to be made one: a merged map is built upon, so more is required."""

from dataclasses import dataclass, field

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import SURE_LOG10_CHANCE, Alignment, NoAlignment, Refusal, count_text
from hickory_stream.alignment.config import AlignConfig
from hickory_stream.alignment.object_map import ObjectMap
from hickory_stream.base.ranges import Ranged, number


@dataclass(frozen=True, kw_only=True, slots=True)
class JoiningConfig(Ranged):
    """When two maps are joined.

    Attributes:
        align: how they are aligned.
        max_log10_chance: maximum log10 of the expected number of false alarms of an alignment that joins two maps.
    """

    align: AlignConfig = field(default_factory=AlignConfig)
    max_log10_chance: float = number(SURE_LOG10_CHANCE, -1000, 1000, "log10")


def aligned_to_join(map_a: ObjectMap, map_b: ObjectMap, config: JoiningConfig | None = None) -> Alignment | NoAlignment:
    """Return what `align` does, but refuse an answer that is not sure enough to join two maps."""
    config = JoiningConfig() if config is None else config
    answer = align(map_a, map_b, config.align)
    if isinstance(answer, NoAlignment) or answer.log10_chance <= config.max_log10_chance:
        return answer
    return NoAlignment(
        refusal=Refusal.CHANCE,
        reason=f"{len(answer.pairs)} pairs agree, but {count_text(answer.log10_chance)} such sets of pairs are "
        f"expected by chance; to merge maps at most {count_text(config.max_log10_chance)} is accepted, to align them "
        f"{count_text(config.align.acceptance.max_log10_chance)}",
        contradictions=answer.contradictions,
        notes=answer.notes,
    )
