"""Choice of shape workers by the configuration: child processes, or a cluster."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.engine.shape_jobs.generators.choose import chosen_generator
from hickory_stream.engine.shape_jobs.generators.spec import cluster_resources, read_spec
from hickory_stream.engine.shape_jobs.local_workers import LocalWorkers, ShapeWorkers, WorkerLimits

if TYPE_CHECKING:
    from hickory_stream.config import MapperConfig


def make_workers(config: MapperConfig) -> ShapeWorkers:
    """Return the configured workers. Raises `ConfigError`: they are not available."""
    generator = chosen_generator(config)
    time_s = config.run.job_timeout_s
    resources = {"GPU": config.run.cluster_gpus} if config.run.cluster_gpus > 0 else {}
    if generator is not None:
        # The generator has limits of its own; a second process is tried where the first one fails.
        spec = read_spec(generator)
        time_s += 2 * (spec.start_s + spec.time_s)
        # What the configuration says goes before what the generator says.
        resources = {**cluster_resources(spec), **resources}
    limits = WorkerLimits(time_s=time_s, memory_mb=config.run.job_memory_mb)
    if config.run.cluster:
        from hickory_stream.engine.shape_jobs.dask_workers import DaskWorkers

        return DaskWorkers(config.run.cluster, limits, resources)
    return LocalWorkers(config.run.workers, limits, config.run.worker_python, generator)
