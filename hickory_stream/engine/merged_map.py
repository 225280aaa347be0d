"""A merged map as a folder: pixels and meshes of all inputs renamed, and shapes rebuilt where needed.

The manifest's `source` lists inputs with digests, the outcome of every pair of maps, and the origins of every object.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

from hickory_stream.alignment.answer import Alignment, count_text
from hickory_stream.base.atomic_files import disk_errors, link_or_copy, outside_errors, write_atomically
from hickory_stream.base.config_text import from_dict
from hickory_stream.base.confined import path_within
from hickory_stream.base.former_keys import with_current_names
from hickory_stream.engine.shape_jobs.processor import processor_kind
from hickory_stream.geometry.codecs.mesh_file import SUFFIX, mesh_file_bytes
from hickory_stream.geometry.mesh import sha256_of
from hickory_stream.map_folder.manifest import Manifest
from hickory_stream.map_folder.saved_map import SavedMap
from hickory_stream.map_folder.views import crop_files, read_crop
from hickory_stream.map_folder.writer import MapFolder, create_map_folder
from hickory_stream.merging.layout import PairOutcome
from hickory_stream.merging.merge_maps import Merged
from hickory_stream.merging.objects import MergedObject
from hickory_stream.ports import NoShape, ShapeInputs
from hickory_stream.records import ObjectShape, TrackedObject
from hickory_stream.shapes.build import ShapeConfig, build_shape, make_reconstructor

_MERGED_REVISION = 1_000_000


def write_merged_map(
    out: Path,
    merged: Merged,
    inputs: Sequence[SavedMap],
    *,
    overwrite: bool,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Manifest:
    """Write a merged map into the folder `out`; `inputs` are the maps that `merge_maps` merged, in the same order.

    `overwrite` replaces an existing map. `progress` receives the numbers of rebuilt and of all shapes to rebuild.

    Raises `MapFolderError`: the place is taken or cannot be written, or a file of an input is damaged.
    """
    used = [saved for i, saved in enumerate(inputs) if i not in merged.left_out]
    # What ran on the machine where the first one was made is no part of this map.
    recorded = with_current_names(used[0].manifest.config)
    config = {name: section for name, section in recorded.items() if name != "run"}
    names = {saved.manifest.extractor for saved in used}
    folder = create_map_folder(
        out,
        config=config,
        source=_source(merged, inputs),
        extractor=names.pop() if len(names) == 1 else "",
        processor=processor_kind(),
        overwrite=overwrite,
    )
    shapes = from_dict(ShapeConfig, config["shapes"]) if isinstance(config.get("shapes"), dict) else ShapeConfig()
    total = sum(one.needs_shape for one in merged.objects)
    done, items, lost = 0, [], 0
    for one in merged.objects:
        _copy_views(folder, one.item, merged, inputs)
        item = _with_mesh(folder, one.item, merged, inputs)
        if one.needs_shape:
            item = _reshaped(folder, one, item, shapes)
            done += 1
            lost += item.shape is None
            progress(done, total)
        items.append(item)
    folder.save(replace(merged.snapshot, objects=tuple(items)))
    folder.write_json("ledger.json", {"shapes": {"made_anew": done, "without": lost}})
    folder.write_json("timings.json", {})
    return folder.finish(finished_cleanly=True)


def outcome_text(pair: PairOutcome) -> str:
    """Return the outcome of a pair of maps in a few words."""
    if not isinstance(pair.answer, Alignment):
        return f"not aligned ({pair.answer.refusal.value}): {pair.answer.reason}"
    text = f"{len(pair.answer.pairs)} pairs, {count_text(pair.answer.log10_chance)} such sets expected by chance"
    return text if pair.is_believed else f"REJECTED, the other alignments contradict it: {text}"


def _source(merged: Merged, inputs: Sequence[SavedMap]) -> dict[str, Any]:
    digests = [saved.manifest.digest for saved in inputs]
    used = [saved.folder.name for i, saved in enumerate(inputs) if i not in merged.left_out]
    return {
        "kind": "merge",
        "uri": " + ".join(used),
        "identity": "+".join(str(digest) for digest in digests),
        "maps": [
            {
                "path": str(saved.folder),
                "digest": digest,
                "source": saved.manifest.source,
                "world_from_map": None if pose is None else pose.tolist(),
                "first_frame": first,
            }
            for saved, digest, pose, first in zip(
                inputs, digests, merged.world_from_map, merged.first_frames, strict=True
            )
        ],
        "pairs": [{"a": pair.a, "b": pair.b, "outcome": outcome_text(pair)} for pair in merged.pairs],
        "provenance": {str(new): [list(member) for member in old] for new, old in merged.provenance.items()},
    }


def _copy_views(folder: MapFolder, item: TrackedObject, merged: Merged, inputs: Sequence[SavedMap]) -> None:
    known = [i for i, pose in enumerate(merged.world_from_map) if pose is not None]
    for view in item.views:
        origin = max(i for i in known if merged.first_frames[i] <= view.frame_index)
        old_name = replace(view, frame_index=view.frame_index - merged.first_frames[origin]).name
        for file in crop_files(inputs[origin].views, old_name):
            new_name = f"{view.name}{file.name.removeprefix(old_name)}"
            _copied(inputs[origin].folder, f"views/{file.name}", folder.views / new_name)


def _with_mesh(folder: MapFolder, item: TrackedObject, merged: Merged, inputs: Sequence[SavedMap]) -> TrackedObject:
    if item.shape is None:
        return item
    origin = next(i for i, old in merged.provenance[item.id] if _has_mesh(inputs[i], old, item.shape))
    name = f"{item.id:06d}-{item.shape.revision:06d}{PurePath(item.shape.mesh_name).suffix}"
    _copied(inputs[origin].folder, f"shapes/{item.shape.mesh_name}", folder.shapes / name)
    return replace(item, shape=replace(item.shape, mesh_name=name))


def _has_mesh(saved: SavedMap, object_id: int, shape: ObjectShape) -> bool:
    own = next(tracked.shape for tracked in saved.snapshot.objects if tracked.id == object_id)
    return own is not None and own.mesh_sha256 == shape.mesh_sha256


def _reshaped(folder: MapFolder, one: MergedObject, item: TrackedObject, config: ShapeConfig) -> TrackedObject:
    first = [item.best_view] if item.best_view is not None else []
    others = [view for view in item.views if not first or view.name != first[0].name]
    floors = [float(item.points_world[:, 2].min())] if len(item.points_world) else [None]
    inputs = ShapeInputs(
        # The files have the poses of their own maps.
        crops=tuple(
            replace(read_crop(folder.views, view.name), world_from_camera=view.world_from_camera)
            for view in [*first, *others]
        ),
        points_world=item.points_world,
        colors=item.colors,
        box=item.box,
        support_z_m=floors[0],
    )
    # No generator is asked for a merge.
    reconstructor = make_reconstructor("fused" if config.reconstructor == "external" else config.reconstructor, config)
    built = build_shape(inputs, reconstructor, config)
    if isinstance(built, NoShape):
        return item
    old = item.shape.revision if item.shape is not None else 0
    name = f"{item.id:06d}-{_MERGED_REVISION + old:07d}{SUFFIX}"
    with disk_errors(folder.path):
        write_atomically(folder.shapes / name, mesh_file_bytes(built.reconstruction.mesh), sync=False)
    shape = ObjectShape(
        revision=_MERGED_REVISION + old,
        reconstructor=reconstructor.name,
        mesh_name=name,
        mesh_sha256=sha256_of(built.reconstruction.mesh),
        world_from_object=built.reconstruction.world_from_object,
        fitted=built.fitted,
        inflated=built.inflated,
        seen_share=built.seen_share,
        containment=built.containment,
        fit_kind=built.fit_kind,
    )
    return replace(one.item, shape=shape)


def _copied(folder: Path, name: str, target: Path) -> None:
    # A hard link where the disk can: neither file is changed in place.
    with outside_errors():
        source = path_within(folder, name)
    with disk_errors(target):
        target.unlink(missing_ok=True)
        link_or_copy(source, target)
