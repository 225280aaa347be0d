"""`hickory-stream models`: list or check the networks of this machine; `model_files` gets and adds them."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, assert_never

from hickory_stream.cli.output_files import add_output, write_picture
from hickory_stream.cli.setup.model_files import KINDS, add_adding
from hickory_stream.errors import ModelError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.cli.commands import Commands
    from hickory_stream.perception.models.library import ModelEntry
    from hickory_stream.perception.models.network import Network
    from hickory_stream.perception.perceive import PerceptionConfig

# Texts of `check` for the built-in picture.
_TEXTS = ("a photo of a cup of coffee.", "a photo of a dog.")


def add(commands: Commands) -> None:
    actions = commands.group("models", _list)
    actions.add("where", _where)
    actions.add("list", _list)
    add_adding(actions)
    check = actions.add("check", _check, configured=True)
    check.add_argument("name", metavar="NAME")
    add_output(check, "-o", "--out", type=Path, metavar="PNG", help="draw the result")


def _where(options: argparse.Namespace) -> int:
    from hickory_stream.perception.models.library import models_folder

    print(output("models-where", {"folder": str(models_folder())}) if options.json else models_folder())
    return 0


def _list(options: argparse.Namespace) -> int:
    from hickory_stream.perception.models.library import find_model, models_folder, read_manifest

    folder = models_folder()
    rows = []
    for name, entry in read_manifest(folder).items():
        try:
            find_model(name, entry.kind, folder=folder)
            state = "ok"
        except ModelError as error:
            state = str(error)
        rows.append({**asdict(entry), "state": state})
    if options.json:
        print(output("models-list", {"folder": str(folder), "models": rows}))
        return 0
    for row in rows:
        width, height = row["input_px"]
        size = f"{width or 'any'} x {height or 'any'}"
        print(f"{row['name']}  {row['kind']}  {size}  {row['licence']}  {row['source']}  {row['state']}")
    if not rows:
        print(
            f"no models in {folder}; get a published one with `hickory-stream models get NAME`, or add your own with "
            "`hickory-stream models add FILE --kind KIND`"
        )
    return 0


def _check(options: argparse.Namespace) -> int:

    from hickory_stream.cli.option_values import read_settings
    from hickory_stream.perception.models.library import find_model, models_folder, read_manifest
    from hickory_stream.perception.models.network import Network, available_providers

    config = read_settings(options).mapper.perception
    entry = read_manifest(models_folder()).get(options.name)
    # The search for one that is not there says what to do.
    entry, path = find_model(options.name, entry.kind if entry is not None else _guess(options.name))
    network = Network(path, config.network)
    report, picture = _tried(entry, network, config)
    report = {
        "name": entry.name,
        "kind": entry.kind,
        "provider": network.provider,
        "providers": list(available_providers()),
        "warm_up_ms": None if network.warm_up_s is None else round(1e3 * network.warm_up_s, 1),
        "run_ms": round(1e3 * network.last_s, 1),
        **report,
    }
    if options.out is not None:
        write_picture(options.out, picture)
        report["picture"] = str(options.out)
    if options.json:
        print(output("models-check", report))
    else:
        print("\n".join(f"{key:<12}{value}" for key, value in report.items()))
    return 0


def _tried(entry: ModelEntry, network: Network, config: PerceptionConfig) -> tuple[dict[str, Any], NDArray[np.uint8]]:
    from dataclasses import replace

    import numpy as np

    from hickory_stream.perception.models.dinov2 import DinoExtractor
    from hickory_stream.perception.models.fastsam import FastSam
    from hickory_stream.perception.models.image_text import open_image_text
    from hickory_stream.perception.models.preprocessing import built_in_picture
    from hickory_stream.perception.models.sam import open_sam
    from hickory_stream.perception.models.semantic_graph import GraphSemantics
    from hickory_stream.pictures.show_perception import classes_picture, features_picture, masks_picture

    rgb = built_in_picture()
    warm_up = config.network.warm_up
    match entry.kind:
        case "fastsam":
            masks, num_not_finite = FastSam(network, config.fastsam, warm_up=warm_up).masks(rgb)
            return {"masks": len(masks), "not_finite": num_not_finite}, masks_picture(rgb, masks)
        case "sam":
            masks, num_not_finite = open_sam(entry, network, config.network, config.sam).masks(rgb)
            return {"masks": len(masks), "not_finite": num_not_finite}, masks_picture(rgb, masks)
        case "dinov2":
            patches = DinoExtractor(network, config.dinov2, warm_up=warm_up).extract(rgb)
            report = {"patches": list(patches.shape[:2]), "dim": patches.shape[2]}
            return report, features_picture(patches, (rgb.shape[1], rgb.shape[0]))
        case "oneformer" | "semantic":
            model = GraphSemantics(
                network,
                entry.labels,
                short_px=config.semantic.short_px,
                panoptic=replace(config.semantic.panoptic),
                warm_up=warm_up,
            )
            semantics = model.classify(rgb)
            ids, areas = np.unique(semantics.classes, return_counts=True)
            shares = {
                "nothing" if i < 0 else semantics.labels[i]: round(float(a) / semantics.classes.size, 3)
                for i, a in sorted(zip(ids.tolist(), areas.tolist(), strict=True), key=lambda pair: -pair[1])
            }
            return {"classes": shares}, classes_picture(rgb, semantics)
        case "image-text":
            pair = open_image_text(entry, network, config.network)
            if warm_up:
                pair.warm_up(rgb)
            feature = pair.of_image(rgb)
            scores = {text: round(float(feature @ pair.of_text(text)), 4) for text in _TEXTS}
            return {"dim": len(feature), "similarity": scores}, rgb
        case _:
            assert_never(entry.kind)


def _guess(name: str) -> Any:
    return next((kind for kind in KINDS if kind in name.lower()), "fastsam")
