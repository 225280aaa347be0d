"""Layer 2 of a map's object with a texture, baked on request from the kept views.

The texture is the same whenever it is made; stored, it would double layer 2 and cost every run.
"""

from dataclasses import replace
from pathlib import Path

from hickory_stream.geometry.mesh import Mesh
from hickory_stream.map_folder.views import crop_files, read_crop
from hickory_stream.records import TrackedObject
from hickory_stream.textures.bake import TextureConfig, textured
from hickory_stream.textures.textured_mesh import TexturedMesh


def textured_object(
    views: Path, tracked: TrackedObject, mesh: Mesh, most_px: int, *, is_past: bool = False
) -> TexturedMesh:
    """Return the mesh of an object's shape, in the object's frame, with a texture of at most `most_px` on a side.

    `views` is a map folder's. `is_past`: an object of an earlier moment, some of whose views may be gone.

    Raises `MapFolderError`: a view is missing or damaged.
    """
    assert tracked.shape is not None
    # Where a view's submap was moved, the map knows it, not the view's file.
    crops = [
        replace(read_crop(views, view.name), world_from_camera=view.world_from_camera)
        for view in tracked.views
        if not is_past or all(path.exists() for path in crop_files(views, view.name))
    ]
    return textured(mesh, tracked.shape.world_from_object, crops, TextureConfig(most_px=most_px))
