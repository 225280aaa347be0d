"""Training: balanced cross entropy of affinities, small things as dear as large ones; stopped and resumed at any step.

Everything is drawn from the seed and the number of the step, so that a run that was broken off goes on as if it had not
been. The learning rate of a stage rises, stays, and falls over its last steps (Hu et al. 2024).
"""

from __future__ import annotations

import math
import sys
import time
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits

from hickory_stream.perception.pixel_network import DISTANCES_PX, OFFSETS, THING
from tools.network_training.lessons import UNKNOWN, lesson_of
from tools.network_training.model import AffinityNet, inputs_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from tools.network_training.frames import TrueFrame
    from tools.network_training.lessons import Lesson
    from tools.network_training.stages import Schedule, Stage

_USUAL_AREA_PX = 400.0


def train(
    frame_of: Callable[[np.random.Generator, Stage], TrueFrame], schedule: Schedule, checkpoint: Path
) -> AffinityNet:
    """Return the network trained on frames that `frame_of(rng, stage)` draws.

    It goes on from a checkpoint if there is one.
    """
    torch.manual_seed(schedule.seed)
    net = AffinityNet().to(memory_format=torch.channels_last)
    optimizer = torch.optim.AdamW(net.parameters(), weight_decay=schedule.weight_decay)
    first, before_s = 0, 0.0
    if checkpoint.is_file():
        kept = torch.load(checkpoint, weights_only=True)
        net.load_state_dict(kept["net"])
        optimizer.load_state_dict(kept["optimizer"])
        first, before_s = kept["step"], kept["processor_s"]
    net.train()
    started, started_cpu_s, told = time.monotonic(), time.process_time(), [0.0, 0]
    for step in range(first, schedule.steps):
        rng = np.random.default_rng([schedule.seed, step])
        stage, step_of_stage = schedule.at(step)
        lessons = [lesson_of(frame_of(rng, stage), rng) for _ in range(stage.batch)]
        rate = stage.rate_at(step_of_stage)
        for group in optimizer.param_groups:
            group["lr"] = rate
        loss = _loss_of(net, lessons, schedule.precision)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimizer.step()
        told = [told[0] + loss.item(), told[1] + 1]
        if not math.isfinite(told[0]):
            raise RuntimeError(f"step {step}: the loss is {loss.item()}; lower the rate")
        done = step + 1
        if done % schedule.told_every == 0:
            spent = time.monotonic() - started
            print(
                f"step {done} of {schedule.steps}: loss {told[0] / told[1]:.4f}, rate {rate:.2g}, "
                f"{spent / (done - first):.2f} s a step, {spent / 60:.1f} min",
                file=sys.stderr,
                flush=True,
            )
            told = [0.0, 0]
        if done % schedule.kept_every == 0 or done == schedule.steps:
            unfinished = checkpoint.with_suffix(".unfinished")
            spent_s = before_s + time.process_time() - started_cpu_s
            state = {"net": net.state_dict(), "optimizer": optimizer.state_dict(), "step": done, "processor_s": spent_s}
            torch.save(state, unfinished)
            unfinished.replace(checkpoint)
    return net.eval()


def accuracies(net: AffinityNet, lessons: Sequence[Lesson]) -> dict[str, float]:
    """Return the mean of the shares of pairs that are one thing, and of two, that are told right, by distance.

    After them the same of what is a thing and what is structure.
    """
    names = [f"distance {d}" for d in DISTANCES_PX] + ["thing"]
    right, all_of = np.zeros((len(names), 2)), np.zeros((len(names), 2))
    net.eval()
    with torch.no_grad():
        for lesson in lessons:
            said = net(inputs_of(lesson.inputs[None]))[0].numpy() > 0
            true, known = (v[0].numpy() for v in truth_of(torch.from_numpy(lesson.labels[None])))
            for i in range(len(said)):
                row = min(i // 4, len(names) - 1)
                for value in (0, 1):
                    counts = known[i] & (true[i] == bool(value))
                    right[row, value] += np.count_nonzero(said[i][counts] == bool(value))
                    all_of[row, value] += np.count_nonzero(counts)
    return dict(zip(names, (right / np.maximum(all_of, 1)).mean(axis=1).round(4).tolist(), strict=True))


def truth_of(labels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return for (B, h, w) labels what is to be said and where that is known, both (B, NUM_OUTPUTS, h, w) bool.

    Of two pixels of structure nothing is to be said.
    """
    true, known = [], []
    for dy, dx in OFFSETS:
        other = _moved(labels, dy, dx)
        true.append(labels == other)
        known.append((labels != UNKNOWN) & (other != UNKNOWN) & ((labels > 0) | (other > 0)))
    true.append(labels > 0)
    known.append(labels != UNKNOWN)
    return torch.stack(true, dim=1), torch.stack(known, dim=1)


def _moved(image: torch.Tensor, dy: int, dx: int) -> torch.Tensor:
    """Return (B, h, w) the value at each pixel's neighbour, `UNKNOWN` beyond the border; `dy` >= 0."""
    height, width = image.shape[1:]
    out = torch.full_like(image, UNKNOWN)
    if dy < height and abs(dx) < width:
        out[:, : height - dy, max(0, -dx) : width - max(0, dx)] = image[:, dy:, max(0, dx) : width + min(0, dx)]
    return out


def _loss_of(net: AffinityNet, lessons: Sequence[Lesson], precision: str) -> torch.Tensor:
    inputs = inputs_of(np.stack([lesson.inputs for lesson in lessons]))
    labels = torch.from_numpy(np.stack([lesson.labels for lesson in lessons]))
    pixel_weights = torch.from_numpy(np.stack([_weights(lesson.labels) for lesson in lessons]))
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=precision == "bfloat16"):
        said = net(inputs)
    true, known = truth_of(labels)
    pairs = [torch.maximum(pixel_weights, _moved(pixel_weights, dy, dx)) for dy, dx in OFFSETS]
    weights = torch.stack([*pairs, pixel_weights], dim=1) * known
    sums = [(weights * values).sum(dim=(0, 2, 3)).clamp(min=1.0) for values in (true, ~true)]
    # Half way to as many pairs of two things as of one: what is rarer counts more, but not all that much more.
    balance = torch.sqrt(sums[0] / sums[1]).clamp(1 / 8, 8)
    weights = weights * torch.where(true, 1.0, balance[None, :, None, None])
    losses = binary_cross_entropy_with_logits(said.float(), true.float(), reduction="none")
    of_outputs = (losses * weights).sum(dim=(0, 2, 3)) / weights.sum(dim=(0, 2, 3)).clamp(min=1.0)
    return of_outputs[:THING].mean() + 0.5 * of_outputs[THING]


def _weights(labels: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return (h, w) what each pixel counts: the root of how much smaller its thing is than a usual one."""
    _, place, pixels = np.unique(labels, return_inverse=True, return_counts=True)
    weights = np.clip(np.sqrt(_USUAL_AREA_PX / pixels), 0.3, 3.0)
    return np.asarray(weights[place].reshape(labels.shape), dtype=np.float32)
