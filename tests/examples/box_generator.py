"""Example of a generator: a program of its own that answers each job with the box around what the best view shows.

It imports nothing of ours and speaks lines of JSON.
`hickory_stream/engine/shape_jobs/generators/exchange.py` says what lies in
the folder of a job. What comes after its name makes it misbehave, for the tests.
"""

import json
import os
import sys
import time
from pathlib import Path


def main(misdeeds):
    """Serve jobs until standard input ends."""
    say({"ready": True, "model": "box", "version": "1"})
    for line in sys.stdin:
        asked = json.loads(line)
        folder = Path(asked["folder"])
        if "crash" in misdeeds:
            os._exit(3)
        if "hang" in misdeeds:
            time.sleep(60)
        if "grow" in misdeeds:
            hoard = bytearray(os.urandom(1)) * 400_000_000
            time.sleep(60)
            say({"hoard": len(hoard)})
        job = json.loads((folder / "job.json").read_text())["job"]
        answer(folder, job, misdeeds)
        say({"done": asked["job"]})


def say(message):
    """Print one line of the protocol."""
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def answer(folder, job, misdeeds):
    """Write the box in a frame of its own: half as large, lying on its side; or why there is none."""
    # Weights would be loaded before it is ready; these make a process that never answers start at once.
    import cv2
    import numpy as np
    import trimesh

    job = "another" if "another" in misdeeds else job
    camera = json.loads((folder / "camera.json").read_text())
    depth = np.load(folder / "depth.npy")
    rows, columns = np.nonzero((cv2.imread(str(folder / "mask.png"), cv2.IMREAD_GRAYSCALE) > 0) & (depth > 0))
    if len(rows) < 20 or "none" in misdeeds:
        (folder / "no_shape.json").write_text(json.dumps({"job": job, "reason": "hardly any depth"}))
        return
    z = depth[rows, columns]
    x, y = (columns - camera["cx"]) / camera["fx"] * z, (rows - camera["cy"]) / camera["fy"] * z
    world = np.column_stack([x, y, z, np.ones(len(z))]) @ np.array(camera["world_from_camera"]).T
    low, high = np.quantile(world[:, :3], [0.01, 0.99], axis=0)
    box = trimesh.creation.box(high - low).subdivide().subdivide()
    if "deep" in misdeeds:
        # It makes up a step of half the height, as long again, behind what the best view shows.
        forward = np.array(camera["world_from_camera"])[:2, 2]
        axis = int(np.abs(forward).argmax())
        shift = np.array([0.0, 0.0, -0.25 * (high - low)[2]])
        shift[axis] = (high - low)[axis] * np.sign(forward[axis])
        step = trimesh.creation.box((high - low) * (1, 1, 0.5)).apply_translation(shift)
        box = trimesh.util.concatenate(box, step.subdivide().subdivide())
    box.apply_transform([[0, 0.5, 0, 3], [-0.5, 0, 0, 1], [0, 0, 0.5, -2], [0, 0, 0, 1]])
    if "nan" in misdeeds:
        box.vertices[0] = np.nan
    data = trimesh.Trimesh(box.vertices, box.faces, process=False).export(file_type="glb")
    if "torn" in misdeeds:
        data = data[: len(data) // 2]
    if "huge" in misdeeds:
        data = data.replace(b'"count":', b'"count":9999')
        data = data[:8] + len(data).to_bytes(4, "little") + data[12:]
    if "outside" in misdeeds:
        data = b"glTF" + data[4:].replace(b'"byteLength"', b'"uri":"x"  ', 1)
    (folder / "mesh.glb").write_bytes(data)
    (folder / "result.json").write_text(json.dumps({"job": job}))


if __name__ == "__main__":
    main(sys.argv[1:])
