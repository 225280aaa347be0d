"""`hickory-stream models get` and `models add`: published weights, or files at hand, become networks here."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.base.terminal import clear_line
from hickory_stream.errors import ConfigError, InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping

    from hickory_stream.cli.commands import Commands
    from hickory_stream.perception.models.library import Kind, ModelEntry
    from hickory_stream.perception.models.published import Published

KINDS = ("fastsam", "sam", "dinov2", "oneformer", "semantic", "image-text")
# Those of `perception.models.published`, whose import takes longer than help may.
_PUBLISHED = ("fastsam-s", "fastsam-x", "dinov2-small", "oneformer-ade20k")


def add_adding(actions: Commands) -> None:
    """Add the two commands."""
    getting = actions.add("get", _get)
    getting.add_argument("name", metavar="NAME", choices=_PUBLISHED, help=", ".join(_PUBLISHED))
    getting.add_argument(
        "--from", dest="origin", metavar="FOLDER", help="folder with the published files, or address of a mirror"
    )
    getting.add_argument("--yes", action="store_true", help="agree to the download and its licence")
    _add_input_px(getting)
    adding = actions.add("add", _add)
    adding.add_argument("file", type=Path, metavar="FILE", help="ONNX, or weights; of a pair, the folder")
    adding.add_argument("--kind", required=True, choices=KINDS)
    adding.add_argument("--name", help="name in the configuration; default: the file name without ending")
    adding.add_argument("--source", default="added by hand", help="origin of the weights")
    adding.add_argument("--licence", default="not stated")
    adding.add_argument("--labels", type=Path, metavar="FILE", help="class names, one a line, by id")
    _add_input_px(adding)


def _add_input_px(command: argparse.ArgumentParser) -> None:
    command.add_argument("--input-px", type=int, default=640, metavar="N", help="export: side of FastSAM's image")


def _get(options: argparse.Namespace) -> int:
    from hickory_stream.perception.models.export import require_exporter
    from hickory_stream.perception.models.library import models_folder
    from hickory_stream.perception.models.published import PUBLISHED, collect

    model = PUBLISHED[options.name]
    print(_plan(model, options.origin), file=sys.stderr)
    require_exporter(model.kind)
    if options.origin is None or "://" in options.origin:
        _confirm(is_agreed=options.yes)
    downloads = models_folder() / "downloads" / model.name
    try:
        collect(model, downloads, options.origin, lambda done: _show_progress(done, model.num_bytes))
    finally:
        _show_progress(0, 0)
    weights = downloads / model.files[0].name if len(model.files) == 1 else downloads
    texts = {"name": model.name, "source": model.source, "licence": model.licence}
    status = _export(options, model.kind, weights, texts)
    shutil.rmtree(downloads)
    return status


def _plan(model: Published, origin: str | None) -> str:
    files = ", ".join(f"{file.name} ({file.num_bytes / 1e6:.3g} MB)" for file in model.files)
    lines = [
        f"{model.name}: {model.num_bytes / 1e6:.0f} MB from {origin or model.address}",
        f"  files    {files}",
        f"  licence  {model.licence}",
        *([f"           {model.licence_note}"] if model.licence_note else []),
        "  then     export to ONNX, comparison with the package's own prediction, entry in the folder of models",
    ]
    return "\n".join(lines)


def _confirm(*, is_agreed: bool) -> None:
    if is_agreed:
        return
    if not sys.stdin.isatty():
        raise InputError("nothing was fetched: agree with --yes")
    if input("Fetch? [y/N] ").strip().lower() not in ("y", "yes"):
        raise InputError("nothing was fetched")


def _show_progress(done: int, most: int) -> None:
    if sys.stderr.isatty():
        clear_line()
        if done < most:
            sys.stderr.write(f"{done / 1e6:.0f} of {most / 1e6:.0f} MB")


def _add(options: argparse.Namespace) -> int:
    path, kind = options.file, options.kind
    texts = {
        "name": options.name or (path.resolve().name if path.is_dir() else path.stem),
        "source": options.source,
        "licence": options.licence,
    }
    if kind == "image-text":
        from hickory_stream.perception.models.image_text import published_files

        if options.labels is not None:
            raise ConfigError("found --labels for an image-text network, which has no classes; leave it out")
        return _add_files(options, kind, published_files(path), texts)
    if kind == "sam":
        from hickory_stream.perception.models.sam import pair_of

        return _add_files(options, kind, pair_of(path), texts)
    if path.suffix != ".onnx" and path.exists():
        return _export(options, kind, path, texts)
    return _add_files(options, kind, {"graph": path}, texts, labels=_read_labels(options.labels))


def _export(options: argparse.Namespace, kind: Kind, weights: Path, texts: Mapping[str, str]) -> int:
    from hickory_stream.perception.models.export import export_model

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "graph.onnx"
        done = export_model(kind, weights, file, options.input_px)
        return _add_files(options, kind, {"graph": file}, texts, labels=done.labels, compared=done.compared)


def _add_files(
    options: argparse.Namespace,
    kind: Kind,
    files: Mapping[str, Path],
    texts: Mapping[str, str],
    *,
    labels: tuple[str, ...] = (),
    compared: str | None = None,
) -> int:
    # `files` by their roles, the graph that takes the image first.
    from hickory_stream.perception.models.library import Companion, ModelEntry, add_model, models_folder, sha256_of

    (_, main), *others = files.items()
    name, sizes = texts["name"], _checked(kind, files, labels)
    try:
        entry = ModelEntry(
            **texts,
            kind=kind,
            file=f"{name}.onnx",
            sha256=sha256_of(main),
            input_px=sizes,
            labels=labels,
            companions=tuple(
                Companion(role=role, file=f"{name}.{role}{path.suffix}", sha256=sha256_of(path))
                for role, path in others
            ),
        )
    except ValueError as error:
        raise ConfigError(str(error)) from error
    add_model(models_folder(), main, entry, files)
    return _report_added(entry, compared, as_json=options.json)


def _checked(kind: Kind, files: Mapping[str, Path], labels: tuple[str, ...]) -> tuple[int, int]:
    # Width and height of the input. A graph that cannot be used is refused now, not in the first run.
    from hickory_stream.perception.models.fastsam import FastSam, FastSamConfig
    from hickory_stream.perception.models.image_text import ImageTextNetwork
    from hickory_stream.perception.models.network import Network, NetworkConfig
    from hickory_stream.perception.models.sam import Sam, SamConfig
    from hickory_stream.perception.models.semantic_graph import GraphSemantics, PanopticConfig

    config = NetworkConfig(provider="cpu", warm_up=False)
    network = Network(next(iter(files.values())), config)
    if kind == "sam":
        Sam(network, Network(files["decoder"], config), SamConfig(), warm_up=False)
        return 0, 0
    height, width = network.require_image_input(kind)
    match kind:
        case "fastsam":
            FastSam(network, FastSamConfig(), warm_up=False)
        case "oneformer" | "semantic":
            if not labels:
                raise ConfigError(f"a model of kind {kind} needs the names of its classes: --labels FILE")
            GraphSemantics(network, labels, short_px=32, panoptic=PanopticConfig(), warm_up=False)
        case "image-text":
            ImageTextNetwork(
                network,
                Network(files["text"], config),
                tokenizer=files["tokenizer"],
                preprocessor=files["preprocessor"],
                tokenizer_config=files.get("tokenizer-config"),
            )
        case _:
            pass
    return width or 0, height or 0


def _report_added(entry: ModelEntry, compared: str | None, *, as_json: bool) -> int:
    from hickory_stream.perception.models.library import models_folder

    report = {"name": entry.name, "file": str(models_folder() / entry.file), "sha256": entry.sha256}
    if as_json:
        print(output("models-add", {**report, "licence": entry.licence, "compared": compared}))
        return 0
    print(f"{report['file']} is the model {entry.name}, sha256 {entry.sha256}, licence {entry.licence}")
    if compared is not None:
        print(f"comparison with the package: {compared}")
    return 0


def _read_labels(path: Path | None) -> tuple[str, ...]:
    if path is None:
        return ()
    try:
        return tuple(line.strip() for line in path.read_text(encoding="utf-8").splitlines() if line.strip())
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read the labels {path}: {error}") from error
