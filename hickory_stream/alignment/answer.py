"""The results of `align`: an `Alignment`, or a `NoAlignment` with its reason; never the identity for a failure."""

from dataclasses import dataclass, field
from enum import StrEnum
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.hypothesis import Hypothesis
from hickory_stream.geometry.arrays import freeze_all

# log10 of the expected false alarms above which an alignment is weak: unrelated rooms that look alike reach -2.2 in two
# of 144 pairs, right alignments of such rooms -12 and less.
SURE_LOG10_CHANCE = -8.0


class Refusal(StrEnum):
    """Why two maps were not aligned."""

    EMPTY = "empty"
    TOO_FEW_OBJECTS = "too-few-objects"
    TOO_FEW_PAIRS = "too-few-pairs"
    CHANCE = "chance"
    COLLINEAR = "collinear"
    UNCERTAIN = "uncertain"
    RIVAL = "rival"
    MIRRORED = "mirrored"
    CONTRADICTED = "contradicted"


@dataclass(frozen=True, kw_only=True, slots=True)
class MatchedPair:
    """One object in both maps: its ids, its scores in 0..1 (None if unknown) and the residual between its centroids."""

    id_a: int
    id_b: int
    semantic: float | None
    geometric: float | None
    rank: float
    residual_m: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Contradictions:
    """The check against observed space: objects of one map at positions that the other map has observed.

    `expected` and `missing` weigh what `num_expected` and `num_missing` count: a fixture, which stays, counts more.
    """

    num_expected: int = 0
    #: in free space; `ids_a` and `ids_b` are missing in the other map
    num_missing: int = 0
    ids_a: tuple[int, ...] = ()
    ids_b: tuple[int, ...] = ()
    expected: float = 0.0
    missing: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rival:
    """One of several significant transforms between two maps, for a pose graph that can decide between them later.

    Fields are as those of an `Alignment`, from the objects' centroids alone.
    """

    a_from_b: NDArray[np.float64]
    covariance: NDArray[np.float64]
    center_a: NDArray[np.float64]
    num_pairs: int
    log10_chance: float
    #: negative if the closest rival is better
    margin: float

    def __post_init__(self) -> None:
        freeze_all(self, np.float64, a_from_b=(4, 4), covariance=(6, 6), center_a=(3,))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Alignment:
    """The pose of map b in map a."""

    #: (4, 4)
    a_from_b: NDArray[np.float64]
    pairs: tuple[MatchedPair, ...]
    #: (6, 6) of a small rotation (radians) about `center_a` and a translation (metres), in frame a
    covariance: NDArray[np.float64]
    #: (3,) the pairs' centroid
    center_a: NDArray[np.float64]
    #: log10 of the expected number of equally good sets of pairs between two unrelated maps
    log10_chance: float
    #: decades of significance of the evidence that separates it from its closest `rival`
    margin: float
    rival: Hypothesis | None
    contradictions: Contradictions = field(default_factory=Contradictions)
    is_level: bool = True
    is_refined: bool = False
    notes: tuple[str, ...] = ()
    #: the other significant transforms, which were ruled out
    rivals: tuple[Rival, ...] = ()

    def __post_init__(self) -> None:
        freeze_all(self, np.float64, a_from_b=(4, 4), covariance=(6, 6), center_a=(3,))

    @property
    def is_weak(self) -> bool:
        """Whether unrelated places that look alike might agree as well; maps are not merged by such an answer."""
        return self.log10_chance > SURE_LOG10_CHANCE

    @property
    def translation_sigma_m(self) -> float:
        """The standard deviation of the translation, over all directions."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def rotation_sigma_rad(self) -> float:
        """The standard deviation of the rotation, over all axes."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NoAlignment:
    """A refusal; `hypotheses` and, for `Refusal.RIVAL`, `rivals`, of which one may be right, most likely first."""

    refusal: Refusal
    reason: str
    hypotheses: tuple[Hypothesis, ...] = ()
    contradictions: Contradictions = field(default_factory=Contradictions)
    notes: tuple[str, ...] = ()
    rivals: tuple[Rival, ...] = ()


def count_text(log10_count: float) -> str:
    """Return an expected number in decimals with two digits, rounded up, so that more than a limit also reads so."""
    if not -9 <= log10_count <= 6:
        return "more than a million" if log10_count > 6 else "less than 0.000000001"
    places = 1 - floor(log10_count)
    value = ceil(10**log10_count * 10**places - 1e-6) / 10**places
    return f"{value:,.10f}".rstrip("0").rstrip(".")
