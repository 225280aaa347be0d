"""A shape worker whose reconstructor misbehaves: started in place of the interpreter, with the way as argument."""

import ctypes
import itertools
import os
import sys
import time
from dataclasses import replace
import numpy as np
from hickory_stream.engine.shape_jobs import worker
from hickory_stream.ports import Reconstruction
from hickory_stream.testing import BoxReconstructor

WAYS = ("prints", "empty", "nan", "hangs", "grows", "segfaults", "raises", "sleeps")


class Bad:
    name = "fused"

    def __init__(self, way):
        self._way = way

    def reconstruct(self, inputs):
        made = BoxReconstructor().reconstruct(inputs)
        assert isinstance(made, Reconstruction)
        mesh = made.mesh
        match self._way:
            case "prints":
                print('{"done": "something else entirely", "error": "no"}', flush=True)  # noqa: T201 -- that is the point
                os.write(1, b"and past Python\n")
            case "empty":
                none = np.zeros((0, 3))
                mesh = replace(mesh, vertices=none, faces=none.astype(int), colors=none, is_seen=np.zeros(0, bool))
            case "nan":
                vertices = mesh.vertices.copy()
                vertices[0] = np.nan
                mesh = replace(mesh, vertices=vertices)
            case "hangs":
                time.sleep(1000)
            case "grows":
                held = [np.ones(10**7) for _ in range(10)]
                time.sleep(1000)
                assert held
            case "segfaults":
                ctypes.string_at(0)
            case "raises":
                raise RuntimeError("out of ideas")
            case "sleeps":
                time.sleep(np.random.default_rng().uniform(0.0, 0.5))
        return Reconstruction(mesh=mesh, world_from_object=made.world_from_object)


def write_interpreter(path, way):
    """Write a program that takes the place of a worker's interpreter."""
    path.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{__file__}" {way}\n')
    path.chmod(0o755)
    return path


if __name__ == "__main__":
    ways = itertools.cycle(sys.argv[1].split("+"))
    worker.reconstructor_of = lambda config: Bad(next(ways))
    # Many of these are started, and none computes a shape.
    worker.are_compiled = lambda: True
    worker.main()
