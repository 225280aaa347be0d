"""TRELLIS (github.com/microsoft/TRELLIS, code and weights MIT) as a generator: one image, no depth, no scale, no pose.

| what | its convention | ours |
|---|---|---|
| image | RGBA, alpha 0 around the object; it crops and resizes itself | the mask as alpha |
| mesh | `outputs["mesh"][0]`: z up, in a cube of side 1; only its GLB export turns it to y up | kept as it is |
| pose | none | none is said; placement finds it |
| colours | `vertex_attrs`: red, green, blue in 0..1, then normals | bytes |

Set up (Linux, CUDA): `install trellis` beside this file; the folder TRELLIS-image-large goes into `weights/`. The
command of the TOML is the python of that environment.
"""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parent), str(Path(__file__).resolve().parent / "TRELLIS")]

from serving import Made, View, array_of, serve  # noqa: E402 -- beside this script

_SEEDS = 1 << 31


def load() -> tuple[Callable[[View], Made], dict[str, str]]:
    """Return what makes a mesh of a view, and what it is."""
    # It would try several algorithms first, which costs more than it gains for one object at a time.
    os.environ.setdefault("SPCONV_ALGO", "native")
    import torch
    from trellis.pipelines import TrellisImageTo3DPipeline

    weights = str(Path(__file__).resolve().parent / "weights" / "TRELLIS-image-large")
    pipeline = TrellisImageTo3DPipeline.from_pretrained(weights)
    pipeline.cuda()

    def make(view: View) -> Made:
        from PIL import Image

        rgba = np.dstack([view.rgb, view.mask.astype(np.uint8) * 255])
        outputs = pipeline.run(Image.fromarray(rgba, "RGBA"), seed=view.seed % _SEEDS, formats=["mesh"])
        mesh = outputs["mesh"][0]
        colors = None
        if getattr(mesh, "vertex_attrs", None) is not None:
            colors = np.round(array_of(mesh.vertex_attrs)[:, :3] * 255).clip(0, 255).astype(np.uint8)
        return Made(array_of(mesh.vertices), array_of(mesh.faces), colors)

    return make, {"model": "TRELLIS-image-large", "torch": str(torch.__version__)}


if __name__ == "__main__":
    serve(load)
