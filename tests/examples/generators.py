"""The generator of the example, as a TOML would describe it."""

import sys
from functools import cache
from pathlib import Path
from hickory_stream.engine.shape_jobs.generators.choose import ExternalGenerator
from hickory_stream.engine.shape_jobs.generators.spec import GeneratorSpec

HERE = Path(__file__).parent


def box_spec(*misdeeds, start_s=60.0, time_s=60.0, memory_mb=4000.0):
    """Return `box_generator.py` as a generator, with what it is to do wrong."""
    return GeneratorSpec(
        name="box-generator", command=(sys.executable, "box_generator.py", *misdeeds), licence="Apache-2.0",
        start_s=start_s, time_s=time_s, memory_mb=memory_mb, folder=HERE,
    )  # fmt: skip


@cache
def box_generator():
    """Return the one process of the example; it ends when this one does."""
    return ExternalGenerator(box_spec())
