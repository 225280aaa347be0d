"""What a run measures: how many scenes of each data set, how long, and how many trials."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class Plan:
    """The sizes of a run; `seconds` are of synthetic logs and of walks through ReplicaCAD, None: the whole walk."""

    hope_scenes: int
    apartments: int
    robot_pairs: int
    nus_pairs: int
    hope_seconds: float
    apartment_seconds: float | None
    robot_seconds: float
    nus_seconds: float
    trials: int
    seeds: int


FULL = Plan(
    hope_scenes=3, apartments=4, robot_pairs=3, nus_pairs=1, hope_seconds=20.0, apartment_seconds=None,
    robot_seconds=60.0, nus_seconds=60.0, trials=100, seeds=5,
)  # fmt: skip
QUICK = Plan(
    hope_scenes=1, apartments=1, robot_pairs=1, nus_pairs=1, hope_seconds=10.0, apartment_seconds=24.0,
    robot_seconds=24.0, nus_seconds=20.0, trials=20, seeds=2,
)  # fmt: skip
