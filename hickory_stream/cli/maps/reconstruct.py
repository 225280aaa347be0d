"""`hickory-stream reconstruct`: repeat one shape job in this process, for debugging."""

import argparse
from pathlib import Path

from hickory_stream.cli.commands import Commands
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

_MESH = "mesh.glb"  # beside the answer, for inspection


def add(commands: Commands) -> None:
    reconstruct = commands.add("reconstruct", run)
    reconstruct.add_argument("view", type=Path, metavar="VIEW", help="input of a job: a folder in MAP/failed")


def run(options: argparse.Namespace) -> int:
    from hickory_stream.base.atomic_files import write_atomically
    from hickory_stream.engine.shape_jobs.generators.choose import reconstructor_of
    from hickory_stream.engine.shape_jobs.job_folder import JOB, read_job, write_result
    from hickory_stream.errors import HickoryError
    from hickory_stream.geometry.mesh import glb_bytes
    from hickory_stream.ports import NoShape
    from hickory_stream.shapes.build import build_shape

    folder: Path = options.view
    if folder.is_symlink() or folder.parent.is_symlink():
        # The answer is written there: an untrusted map must not choose the place.
        raise InputError(f"{folder} is a link; name its target: {folder.resolve()}")
    if not (folder / JOB).is_file():
        raise InputError(f"{folder} holds no {JOB}; name a folder of MAP/failed, which keeps the input of failed jobs")
    try:
        inputs, config = read_job(folder)
    except HickoryError:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{folder} is not a readable job: {error}") from error
    built = build_shape(inputs, reconstructor_of(config), config)
    mesh = folder / _MESH
    try:
        write_result(folder, built, config.reconstructor)
        if not isinstance(built, NoShape):
            write_atomically(mesh, glb_bytes(built.reconstruction.mesh), sync=False)
    except OSError as error:
        raise InputError(f"cannot write the answer into {folder}: {error.strerror}") from error
    if isinstance(built, NoShape):
        print(
            output("reconstruct", {"shape": None, "reason": built.reason})
            if options.json
            else f"no shape: {built.reason}"
        )
        return 1
    said = {"shape": str(mesh), "superquadrics": len(built.fitted), "seconds": dict(built.timings_s)}
    text = f"{mesh}: {len(built.fitted)} superquadrics in {sum(built.timings_s.values()):.1f} s"
    print(output("reconstruct", said) if options.json else text)
    return 0
