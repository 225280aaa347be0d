"""The schedule of the training: steps, learning rate and batch size of each stage."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class Stage:
    """So many steps of so many lessons; the rate rises, stays and falls."""

    # `rooms`: those of the broad scenes that are learnt from, from the first to before the last.
    steps: int
    batch: int
    rooms: tuple[int, int]
    rate: float = 2e-3
    rising: int = 100
    falling_share: float = 1 / 7

    def rate_at(self, step: int) -> float:
        falling = max(1.0, self.falling_share * self.steps)
        return self.rate * min(1.0, (step + 1) / self.rising, max(0.01, (self.steps - step) / falling))


@dataclass(frozen=True, kw_only=True, slots=True)
class Schedule:
    """Stages in turn; `precision` of the products in training."""

    stages: tuple[Stage, ...]
    seed: int = 0
    weight_decay: float = 1e-2
    precision: str = "bfloat16"
    told_every: int = 50
    kept_every: int = 100

    @property
    def steps(self) -> int:
        return sum(stage.steps for stage in self.stages)

    def at(self, step: int) -> tuple[Stage, int]:
        for stage in self.stages:
            if step < stage.steps:
                return stage, step
            step -= stage.steps
        raise IndexError(f"step {self.steps + step}; the schedule has {self.steps}")
