"""Train the network of affinities from synthetic scenes, write it in eight bits, and its card.

A run that was broken off goes on from its checkpoint. Frames are rendered once and kept beside the
caches: up to 7 GB, which no cap removes.
"""

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hickory_stream.base.caches import cache_root
from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.perception.affinity import pixel_network
from hickory_stream.perception.affinity.pixel_inputs import CHANNELS
from tools.network_training.frames import frames_of_scene, rendered
from tools.network_training.scenes import (
    BROAD,
    HELD_OUT,
    OWN,
    OWN_SHARE,
    RENDERED_AT,
    STAGES,
    Schedule,
    drawn_frames,
    told,
)

_PACKAGE = Path(pixel_network.__file__).parents[1]
_CALIBRATED_ON = 64
LICENCE = "Apache-2.0, as the project: trained on scenes of its own generators alone, no data of others"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="tools/train_network", description=__doc__)
    file = Path(pixel_network.EMBEDDED)
    parser.add_argument("--out", type=Path, default=_PACKAGE / file.parent, help="folder of the network and its card")
    parser.add_argument(
        "--frames", type=Path, help="folder of rendered frames; by default beside the caches, not capped"
    )
    parser.add_argument("--checkpoint", type=Path, help="by default beside the frames; an old one is gone on from")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1, help="of torch")
    parser.add_argument("--device", default="cpu", help="of torch: cpu, cuda")
    parser.add_argument("--processes", type=int, default=0, help="that render and make lessons beside the training")
    parser.add_argument("--export-only", action="store_true", help="write what the checkpoint has, whatever its step")
    options = parser.parse_args(arguments)
    try:
        import torch

        from tools.network_training.export import export
        from tools.network_training.lessons import lesson_of
        from tools.network_training.model import AffinityNet
        from tools.network_training.train import accuracies, read_checkpoint, train
    except ModuleNotFoundError as error:
        print(f"{error.name} is missing; install the extra: pip install -e '.[train]'", file=sys.stderr)
        return 2
    import cv2

    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    frames = options.frames or cache_root() / "network-frames"
    checkpoint = options.checkpoint or frames / "affinities.pt"
    if not options.export_only:
        rendered((*OWN, *BROAD, *HELD_OUT), frames, options.processes)
    drawn = drawn_frames(frames)
    schedule = Schedule(seed=options.seed, stages=STAGES)
    if not options.export_only:
        train(drawn, schedule, checkpoint, options.device, options.processes)
    kept = read_checkpoint(checkpoint)
    net = AffinityNet()
    net.load_state_dict(kept["net"])
    net.eval()
    rng = np.random.default_rng([options.seed, 77])
    calibration = [lesson_of(drawn(rng, STAGES[-1]), rng).inputs for _ in range(_CALIBRATED_ON)]
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / file.name
    export(net, calibration, path)
    held_out = {}
    for scene in HELD_OUT:
        rng = np.random.default_rng([scene.seed, 78])
        held_out[scene.name] = accuracies(net, [lesson_of(frame, rng) for frame in frames_of_scene(scene, frames)])
    card = {
        "what": "A U-Net in eight bits: affinities of pixels to neighbours at four distances, and thing or structure.",
        "follows": [
            "UOIS-Net (Xie et al. 2021), UCN (Xiang et al. 2020): led by depth, trained on synthetic clutter",
            "Wolf et al. 2018, Lee et al. 2017: affinities at growing distances; Bailoni et al. 2019: average linkage",
        ],
        "made_by": f"tools/train_network --seed {options.seed}", "steps_done": kept["step"],
        "training_minutes": round(kept["elapsed_s"] / 60, 1),
        "trained_with": f"{kept['device']}, lessons by {max(kept['processes'], 1)} processes", "licence": LICENCE,
        "torch": torch.__version__,
        "trained_on": {"own": told(OWN), "broad": told(BROAD), "own_share": OWN_SHARE, "rendered_at": RENDERED_AT},
        "schedule": dataclasses.asdict(schedule), "inputs": list(CHANNELS),
        "weights": sum(p.numel() for p in net.parameters()), "bytes": path.stat().st_size,
        "held_out_balanced_accuracy": held_out,
    }  # fmt: skip
    text = dumps_exactly(card, indent=2)
    path.with_suffix(".json").write_text(text + "\n", encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
