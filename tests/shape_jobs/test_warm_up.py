import subprocess
import sys
from pathlib import Path

PROGRAM = """
import gc, sys
sys.path.insert(0, {tests!r})
from numba.core.dispatcher import Dispatcher
from hickory_stream.shapes.build import ShapeConfig, build_shape, make_reconstructor
from hickory_stream.engine.warm_up import warm_up
from hickory_stream.shapes.fit.marching_primitives import fitted_shape
from shape_fixtures import as_mesh, shape_inputs, test_mesh
from tools.evaluation.shapes.meshes import hollow_mesh

def known():
    return {{
        (made.py_func.__qualname__, str(types))
        for made in gc.get_objects()
        if isinstance(made, Dispatcher) and made.py_func.__module__.startswith("hickory_stream.")
        for types in made.signatures
    }}

inputs = [shape_inputs(test_mesh(name), 4) for name in ("mug", "chair")]
warm_up()
before = known()
assert len(before) > 40, before
config = ShapeConfig()
for given in inputs:
    build_shape(given, make_reconstructor("fused", config), config)
assert fitted_shape(as_mesh(hollow_mesh("bowl")), config.fit).kind == "envelope"
print(sorted(known() - before))
"""


def test_the_jobs_after_it_compile_nothing():
    program = PROGRAM.format(tests=str(Path(__file__).parent.parent / "shapes"))
    made = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    assert made.stdout.strip() == "[]"


WRITING = """
import gc
from numba.core.dispatcher import Dispatcher
from hickory_stream.engine.warm_up import warm_up_mapping

warm_up_mapping()
print(sorted({
    made.py_func.__module__.rpartition(".")[2]
    for made in gc.get_objects()
    if isinstance(made, Dispatcher) and ".geometry." in made.py_func.__module__ and made.signatures
}))
"""


def test_it_writes_and_reads_what_a_journal_has_of_a_keyframe():
    made = subprocess.run([sys.executable, "-c", WRITING], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    for name in ("depth_code", "color_code", "lattice", "voxel_blocks"):
        assert f"'{name}'" in made.stdout
