"""Metrics of a run for Prometheus, as text over HTTP."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hickory_stream.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from hickory_stream.records import FrameReport

_MOST = 65535
_FAMILIES = {
    "time": ("hickory_stage_seconds", "Seconds that the last keyframe took, by stage", "stage"),
    "queue": ("hickory_queue_length", "Items that wait, by queue", "queue"),
    "engine": ("hickory_engine", "State of the engine: delay of the loop, workers, memory, frames dropped", "what"),
    "core": ("hickory_core", "State of the core: objects by phase, share of features saved", "what"),
}


_TOPIC_FIGURES = ("rate_hz", "age_s", "bytes_per_s", "received", "dropped", "lost")


class _Topics:
    def __init__(self, topics: Callable[[], Sequence[Mapping[str, Any]]]) -> None:
        self._topics = topics

    def collect(self) -> Iterator[Any]:
        from prometheus_client.core import GaugeMetricFamily

        family = GaugeMetricFamily("hickory_live_topic", "Topics of a live route", labels=("topic", "what"))
        for figures in self._topics():
            for what in _TOPIC_FIGURES:
                if figures[what] is not None:
                    family.add_metric((figures["topic"], what), figures[what])
        yield family


class MetricsSink:
    """Answers `GET /metrics` on `port`; 0 takes a free one. Raises `InputError` if the port is not available."""

    def __init__(self, port: int, bind: str = "127.0.0.1") -> None:
        if not 0 <= port <= _MOST:
            raise InputError(f"found --metrics-port {port}, expected 1 to {_MOST}, or 0 for any that is free")
        # Imported here: most runs have no metrics.
        from prometheus_client import CollectorRegistry, Counter, Gauge, start_http_server

        registry = CollectorRegistry()
        self._frames = Counter("hickory_frames", "Frames that were read", registry=registry)
        self._keyframes = Counter("hickory_keyframes", "Keyframes that were mapped", registry=registry)
        self._objects = Gauge("hickory_objects", "Objects in the map", registry=registry)
        self._families = {
            group: Gauge(name, text, (label,), registry=registry) for group, (name, text, label) in _FAMILIES.items()
        }
        try:
            self._server, self._thread = start_http_server(port, bind, registry)
        except OSError as error:
            raise InputError(
                f"cannot answer on {bind}:{port}: {error.strerror}; choose another --metrics-port"
            ) from error
        self.port = int(self._server.server_port)
        self._registry = registry

    def watch(self, topics: Callable[[], Sequence[Mapping[str, Any]]]) -> None:
        """Add the topics of a live route: `topic` is the name, `_TOPIC_FIGURES` the figures, None for none."""
        self._registry.register(_Topics(topics))

    def show(self, report: FrameReport) -> None:
        """Update the metrics from a report."""
        self._frames.inc()
        if report.snapshot is not None:
            self._objects.set(len(report.snapshot.objects))
        if report.frame is not None:
            self._keyframes.inc()
        for name, value in report.metrics:
            group, _, label = name.partition("/")
            if group in self._families:
                self._families[group].labels(label).set(value)

    def close(self) -> None:
        """Stop the server."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(2.0)
