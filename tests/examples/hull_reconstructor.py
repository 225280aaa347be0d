"""Example of a reconstructor: the convex hull of layer 1 and the views' depth, extended down to the support surface."""

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.ports import NoShape, Reconstruction

_MIN_POINTS, _KEPT_SHARE, _EDGE_M, _SEEN_M = 20, 0.98, 0.03, 0.02


class HullReconstructor:
    """The convex hull without the 2 % of points farthest from the median, which are outliers at depth edges."""

    name = "hull"

    def reconstruct(self, inputs):
        """Return the hull in the frame of the object's box."""
        shown = [
            apply(crop.world_from_camera, backproject(crop.depth_m, crop.camera)[crop.mask & np.isfinite(crop.depth_m)])
            for crop in inputs.crops
        ]
        points_world = np.concatenate([inputs.points_world, *shown]).astype(np.float64)
        if len(points_world) < _MIN_POINTS:
            return NoShape(reason=f"{len(points_world)} points; a hull needs at least {_MIN_POINTS}")
        far_m = np.linalg.norm(points_world - np.median(points_world, axis=0), axis=1)
        points_world = points_world[far_m <= np.quantile(far_m, _KEPT_SHARE)]
        foot = points_world[:, :2] if inputs.support_z_m is not None else points_world[:0, :2]
        standing = np.column_stack([foot, np.full(len(foot), inputs.support_z_m or 0.0)])
        hull = trimesh.convex.convex_hull(np.concatenate([points_world, standing])).subdivide_to_size(_EDGE_M)
        hull.merge_vertices()
        gaps_m, _ = cKDTree(points_world).query(hull.vertices)
        vertices = apply(invert(inputs.box.world_from_box), np.asarray(hull.vertices))
        colors = np.tile(np.median(inputs.colors, axis=0).astype(np.uint8), (len(vertices), 1))
        mesh = Mesh(vertices=vertices, faces=hull.faces, colors=colors, is_seen=gaps_m < _SEEN_M)
        return Reconstruction(mesh=mesh, world_from_object=inputs.box.world_from_box)
