"""The reconstructor of a job: an embedded one, or the machine's generator."""

from __future__ import annotations

import atexit
import os
import tempfile
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.engine.shape_jobs.generators import spec as specs
from hickory_stream.engine.shape_jobs.generators.exchange import read_answer, write_question
from hickory_stream.engine.shape_jobs.generators.process import GeneratorLimitError, GeneratorProcess
from hickory_stream.engine.shape_jobs.generators.refine import ExternalRefiner
from hickory_stream.errors import ConfigError, WorkerError
from hickory_stream.ports import GeneratedMesh, NoShape, Reconstructor, ShapeInputs
from hickory_stream.shapes.build import ShapeConfig, make_reconstructor
from hickory_stream.shapes.generated.placement import EmbeddedPlacement

if TYPE_CHECKING:
    from hickory_stream.config import MapperConfig

_ATTEMPTS = 2


class ExternalGenerator:
    """A `MeshGenerator` that asks a program; a second process is tried if the first one fails."""

    def __init__(self, spec: specs.GeneratorSpec) -> None:
        self.name = spec.name
        self._spec = spec
        self.process = GeneratorProcess(spec)

    def generate(self, inputs: ShapeInputs) -> GeneratedMesh | NoShape:
        """Return the mesh, or why there is none."""
        reason, hit_limit = "", False
        for _ in range(_ATTEMPTS):
            with tempfile.TemporaryDirectory(prefix="hickory-generator-") as temporary:
                folder = Path(temporary).resolve()
                job = write_question(folder, inputs, self._spec.views)
                try:
                    self.process.ask(folder, job)
                    return read_answer(folder, job, self._spec.views)
                except WorkerError as error:
                    reason, hit_limit = str(error), isinstance(error, GeneratorLimitError)
                    # Its next answer may belong to the failed job.
                    self.process.close()
        return NoShape(reason=reason, hit_limit=hit_limit)


def reconstructor_of(config: ShapeConfig) -> Reconstructor:
    """Return the reconstructor of a job; the machine, never the job, chooses the program.

    Raises `ConfigError`: the job needs a generator, and none is set.
    """
    if config.reconstructor != "external":
        return make_reconstructor(config.reconstructor, config)
    path = os.environ.get(specs.CHOICE_VARIABLE, "")
    if not path:
        raise ConfigError(f"this job needs a generator; set ${specs.CHOICE_VARIABLE} to its TOML")
    return generating(Path(path), config)


def generating(spec: Path, config: ShapeConfig) -> Reconstructor:
    """Return the reconstructor that asks the generator of a TOML. Raises `ConfigError`: it cannot be read."""
    process = _refining(str(spec))
    refiner = None if process is None else ExternalRefiner(process, EmbeddedPlacement(config.placement))
    return make_reconstructor("external", config, _generator(str(spec)), refiner)


@cache
def _generator(path: str) -> ExternalGenerator:
    generator = ExternalGenerator(specs.read_spec(Path(path)))
    atexit.register(generator.process.close)
    return generator


@cache
def _refining(path: str) -> GeneratorProcess | None:
    spec = specs.refiner_of(specs.read_spec(Path(path)))
    process = GeneratorProcess(spec) if spec is not None else None
    if process is not None:
        atexit.register(process.close)
    return process


def chosen_generator(config: MapperConfig) -> Path | None:
    """Return the TOML of the generator of a run, None without one; checked before anything is played.

    Raises `ConfigError`: no such generator, its licence was not accepted, or a part is missing.
    """
    if config.shapes.reconstructor != "external":
        return None
    path = specs.find_spec(config.run.generator)
    check_generator(path, config)
    return path


def check_generator(path: Path, config: MapperConfig) -> None:
    """Start the generator of a TOML, and its refiner, and end them again.

    Raises `ConfigError`: its licence was not accepted, a part is missing, or it does not start.
    """
    spec = specs.read_spec(path)
    refiner = specs.refiner_of(spec)
    for program in [spec] if refiner is None else [spec, refiner]:
        specs.check_licence(program, config.run.accept_licence)
        if config.run.cluster:
            continue  # what it needs is on the machines of the cluster
        if missing := specs.missing_of(program):
            lacking = "; ".join(missing)
            raise ConfigError(f"the generator {program.name} ({path}) lacks {lacking}; see `generators check`")
        process = GeneratorProcess(program)
        try:
            process.start()
        except WorkerError as error:
            raise ConfigError(f"{error}; see `hickory-stream generators check {path}`") from error
        finally:
            process.close()


def generator_key(config: MapperConfig) -> str:
    """Return the identity of a run's generator, "" without one."""
    if config.shapes.reconstructor != "external":
        return ""
    return specs.fingerprint(specs.read_spec(specs.find_spec(config.run.generator)))
