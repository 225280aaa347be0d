"""Training: balanced cross entropy of affinities, small things as dear as large; stopped and resumed at any step."""
# Everything follows from the seed and the number of the step, whatever the number of processes: a run resumes exactly.
# The rate of a stage rises, stays, and falls over its last steps (Hu et al. 2024).

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import binary_cross_entropy_with_logits
from torch.utils.data import DataLoader, Dataset

from hickory_stream.perception.affinity.pixel_network import DISTANCES_PX, OFFSETS, THING
from tools.network_training.frames import TrueFrame
from tools.network_training.lessons import UNKNOWN, Lesson, lesson_of
from tools.network_training.model import AffinityNet, inputs_of
from tools.network_training.scenes import Schedule, Stage

_USUAL_AREA_PX = 400.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Batch:
    """`inputs` (B, NUM_INPUTS, H, W) bytes; `labels` (B, H / 2, W / 2) int32; what each pixel counts, float32 alike."""

    inputs: torch.Tensor
    labels: torch.Tensor
    weights: torch.Tensor

    def to(self, device: str) -> "Batch":
        inputs, labels, weights = (v.to(device, non_blocking=True) for v in (self.inputs, self.labels, self.weights))
        return Batch(inputs=inputs, labels=labels, weights=weights)


class _OfSteps(Dataset[Batch]):
    def __init__(self, frame_of: Callable[[np.random.Generator, Stage], TrueFrame], schedule: Schedule) -> None:
        self._frame_of = frame_of
        self._schedule = schedule

    def __len__(self) -> int:
        return self._schedule.steps

    def __getitem__(self, step: int) -> Batch:
        rng = np.random.default_rng([self._schedule.seed, step])
        stage, _ = self._schedule.at(step)
        lessons = [lesson_of(self._frame_of(rng, stage), rng) for _ in range(stage.batch)]
        return Batch(
            inputs=torch.from_numpy(np.stack([lesson.inputs for lesson in lessons])),
            labels=torch.from_numpy(np.stack([lesson.labels for lesson in lessons])),
            weights=torch.from_numpy(np.stack([_weights(lesson.labels) for lesson in lessons])),
        )


def batches(
    frame_of: Callable[[np.random.Generator, Stage], TrueFrame], schedule: Schedule, first: int, processes: int
) -> Iterator[Batch]:
    """Yield the batch of each step from `first` on, made by other processes if `processes` is over 0."""
    dataset = _OfSteps(frame_of, schedule)
    if processes > 0 and first < schedule.steps:
        dataset[first]  # compiles the kernels once, for all processes
    loader = DataLoader(
        dataset, batch_size=None, sampler=range(first, schedule.steps), num_workers=processes,
        prefetch_factor=2 if processes > 0 else None, multiprocessing_context="fork" if processes > 0 else None,
    )  # fmt: skip
    return iter(loader)


def _weights(labels: NDArray[np.int32]) -> NDArray[np.float32]:
    _, place, pixels = np.unique(labels, return_inverse=True, return_counts=True)
    weights = np.clip(np.sqrt(_USUAL_AREA_PX / pixels), 0.3, 3.0)
    return np.asarray(weights[place].reshape(labels.shape), dtype=np.float32)


def train(
    frame_of: Callable[[np.random.Generator, Stage], TrueFrame], schedule: Schedule, checkpoint: Path,
    device: str = "cpu", processes: int = 0,
) -> AffinityNet:  # fmt: skip
    """Return the network trained on frames that `frame_of(rng, stage)` draws, on the processor when it is done."""
    # It goes on from a checkpoint if there is one. `device` is torch's; `processes` make lessons beside the training.
    # The same weights come again on a processor with as many threads; another device rounds in other places.
    torch.manual_seed(schedule.seed)
    net = AffinityNet().to(device, memory_format=torch.channels_last)
    optimizer = torch.optim.AdamW(net.parameters(), weight_decay=schedule.weight_decay)
    first, before_s = 0, 0.0
    if checkpoint.is_file():
        kept = read_checkpoint(checkpoint, device)
        net.load_state_dict(kept["net"])
        optimizer.load_state_dict(kept["optimizer"])
        first, before_s = kept["step"], kept["elapsed_s"]
    net.train()
    started = time.monotonic()
    losses: list[torch.Tensor] = []
    for step, batch in enumerate(batches(frame_of, schedule, first, processes), first):
        stage, step_of_stage = schedule.at(step)
        rate = stage.rate_at(step_of_stage)
        for group in optimizer.param_groups:
            group["lr"] = rate
        loss = _loss_of(net, batch.to(device), schedule.precision)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimizer.step()
        losses.append(loss.detach())
        done = step + 1
        if done % schedule.told_every == 0:
            mean = float(torch.stack(losses).mean())
            if not math.isfinite(mean):
                raise RuntimeError(f"step {step}: the loss is {mean}; lower the rate")
            spent = time.monotonic() - started
            print(
                f"step {done} of {schedule.steps}: loss {mean:.4f}, rate {rate:.2g}, "
                f"{spent / (done - first):.2f} s a step, {spent / 60:.1f} min",
                file=sys.stderr,
                flush=True,
            )
            losses = []
        if done % schedule.kept_every == 0 or done == schedule.steps:
            unfinished = checkpoint.with_suffix(".unfinished")
            state = {
                "net": net.state_dict(), "optimizer": optimizer.state_dict(), "step": done,
                "elapsed_s": before_s + time.monotonic() - started, "device": device, "processes": processes,
            }  # fmt: skip
            torch.save(state, unfinished)
            unfinished.replace(checkpoint)
    return net.cpu().eval()


def read_checkpoint(path: Path, device: str = "cpu") -> dict[str, Any]:
    """Return what training kept: `net`, `optimizer`, `step`, `elapsed_s`, `device` and `processes`."""
    # Raises RuntimeError: the file is of an earlier version.
    kept: dict[str, Any] = torch.load(path, weights_only=True, map_location=device)
    if "elapsed_s" not in kept:
        raise RuntimeError(f"{path}: a checkpoint of an earlier version; remove it, or name another by --checkpoint")
    return kept


def accuracies(net: AffinityNet, lessons: Sequence[Lesson]) -> dict[str, float]:
    """Return the mean of the shares of pairs that are one thing, and of two, that are told right, by distance."""
    # After them the same of what is a thing and what is structure.
    names = [f"distance {d}" for d in DISTANCES_PX] + ["thing"]
    right, all_of = np.zeros((len(names), 2)), np.zeros((len(names), 2))
    net.eval()
    with torch.no_grad():
        for lesson in lessons:
            said = net(inputs_of(torch.from_numpy(lesson.inputs[None])))[0].numpy() > 0
            true, known = (v[0].numpy() for v in truth_of(torch.from_numpy(lesson.labels[None])))
            for i in range(len(said)):
                row = min(i // 4, len(names) - 1)
                for value in (0, 1):
                    counts = known[i] & (true[i] == bool(value))
                    right[row, value] += np.count_nonzero(said[i][counts] == bool(value))
                    all_of[row, value] += np.count_nonzero(counts)
    return dict(zip(names, (right / np.maximum(all_of, 1)).mean(axis=1).round(4).tolist(), strict=True))


def truth_of(labels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return for (B, h, w) labels what is to be said and where that is known, both (B, NUM_OUTPUTS, h, w) bool."""
    # Of two pixels of structure nothing is to be said.
    true, known = [], []
    for dy, dx in OFFSETS:
        other = _moved(labels, dy, dx)
        true.append(labels == other)
        known.append((labels != UNKNOWN) & (other != UNKNOWN) & ((labels > 0) | (other > 0)))
    true.append(labels > 0)
    known.append(labels != UNKNOWN)
    return torch.stack(true, dim=1), torch.stack(known, dim=1)


def _moved(image: torch.Tensor, dy: int, dx: int) -> torch.Tensor:
    height, width = image.shape[1:]
    out = torch.full_like(image, UNKNOWN)
    if dy < height and abs(dx) < width:
        out[:, : height - dy, max(0, -dx) : width - max(0, dx)] = image[:, dy:, max(0, dx) : width + min(0, dx)]
    return out


def _loss_of(net: AffinityNet, batch: Batch, precision: str) -> torch.Tensor:
    labels, pixel_weights = batch.labels, batch.weights
    with torch.autocast(labels.device.type, dtype=torch.bfloat16, enabled=precision == "bfloat16"):
        said = net(inputs_of(batch.inputs))
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
