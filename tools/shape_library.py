"""Layer 3 of real maps as `tools/evaluation/simulated_maps/shapes.npz`: what simulated objects are drawn from."""

import sys
from pathlib import Path

import numpy as np

from hickory_stream.geometry.rigid import quaternion_from_rotation
from hickory_stream.geometry.superquadric import centroid_world
from hickory_stream.map_folder.saved_map import open_map

_OUT = Path(__file__).resolve().parent / "evaluation" / "simulated_maps" / "shapes.npz"


def main(maps: list[str]) -> int:
    """Write the library; the one in the repository is of the first walks of apartments 1000 and 1001."""
    # `tools/bench align` plays them into out/maps/.
    fits = [item.shape.fitted for name in maps for item in open_map(Path(name)).snapshot.objects if item.shape]
    if not fits:
        print("usage: tools/make_shape_library MAP...; found no object with layer 3", file=sys.stderr)
        return 2
    rotations = [pose[:3, :3] for fit in fits for pose in fit.world_from_local]
    np.savez_compressed(
        _OUT,
        counts=np.array([len(fit) for fit in fits], dtype=np.int32),
        exponents=np.concatenate([fit.exponents for fit in fits]).astype(np.float32),
        semi_axes_m=np.concatenate([fit.semi_axes_m for fit in fits]).astype(np.float32),
        centers_m=np.concatenate([f.world_from_local[:, :3, 3] - centroid_world(f) for f in fits]).astype(np.float32),
        quaternions=np.array([quaternion_from_rotation(rotation) for rotation in rotations], dtype=np.float32),
    )
    print(f"{_OUT}: {len(fits)} shapes of {len(rotations)} primitives")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
