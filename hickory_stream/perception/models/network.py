"""One network in onnxruntime: opened on the available accelerator, checked, warmed up, timed.

onnxruntime falls back to the CPU silently. Here a provider that is configured by name is used, or an error is raised;
`auto` uses the best one available and logs its name.
"""

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.errors import ModelError
from hickory_stream.perception.models.shared_runs import IMAGES_A_RUN, SharedRuns

logger = logging.getLogger(__name__)

Provider = Literal["auto", "tensorrt", "cuda", "cpu"]

_NAMES = {"tensorrt": "TensorrtExecutionProvider", "cuda": "CUDAExecutionProvider", "cpu": "CPUExecutionProvider"}
# A TensorRT engine takes minutes to build: it is used only if it is configured by name.
_CHAINS = {"auto": ("cuda", "cpu"), "tensorrt": ("tensorrt", "cuda", "cpu"), "cuda": ("cuda", "cpu"), "cpu": ("cpu",)}


@dataclass(frozen=True, kw_only=True, slots=True)
class NetworkConfig(Ranged):
    """How networks are run."""

    #: `cuda`, `tensorrt` or `cpu`; `auto` takes CUDA where there is one.
    provider: Provider = "auto"
    #: CPU threads of one network, 0: one per core.
    threads: int = number(0, 0, 1024, "threads")
    #: Index of the accelerator.
    device: int = number(0, 0, 255, "index")
    #: Whether a network runs once on an empty image when it is opened, so that the first frame is not slower.
    warm_up: bool = True


@dataclass(frozen=True, kw_only=True, slots=True)
class Tensor:
    """An input or output of a graph: None in `shape` is any length."""

    name: str
    shape: tuple[int | None, ...]
    dtype: str

    def __str__(self) -> str:
        return f"{self.name} ({', '.join('any' if n is None else str(n) for n in self.shape)}) {self.dtype}"


class Network:
    """A loaded ONNX graph.

    Raises:
        ModelError: the file is missing, damaged, or uses an unsupported operator set, or the provider is not available.
    """

    def __init__(self, path: Path, config: NetworkConfig) -> None:
        self.path = path
        self._session = _session(path, config)
        self.inputs = tuple(_tensor(i) for i in self._session.get_inputs())
        self.outputs = tuple(_tensor(o) for o in self._session.get_outputs())
        self.provider = _short(self._session.get_providers()[0])
        self.warm_up_s: float | None = None
        self.num_runs = 0
        self.total_s = 0.0
        self.last_s = 0.0
        self._shared: SharedRuns | None = None
        logger.info("%s runs on %s", path.name, self.provider)

    def require_image_input(self, kind: str) -> tuple[int | None, int | None]:
        """Return height and width (None: any) of the only input, an image (1, 3, H, W) float; raises `ModelError`."""
        shape = self.inputs[0].shape if len(self.inputs) == 1 else ()
        is_image = len(shape) == 4 and shape[0] in (1, None) and shape[1] in (3, None)
        if not is_image or self.inputs[0].dtype not in ("float", "float16"):
            raise self.mismatch(kind, "one image (1, 3, H, W) float or float16 as its input")
        return shape[2], shape[3]

    def mismatch(self, kind: str, expected: str) -> ModelError:
        """Return the error for a graph that is not of a kind; `expected` describes the tensors of that kind."""
        found = f"inputs {', '.join(map(str, self.inputs))}; outputs {', '.join(map(str, self.outputs))}"
        return ModelError(f"{self.path} is no {kind} graph: expected {expected}; found {found}")

    def warm_up(self, image: NDArray[np.float32]) -> None:
        """Run once, and time it separately from later runs; raises `ModelError`."""
        self.run(image)
        self.warm_up_s = self.last_s
        self.num_runs, self.total_s = 0, 0.0

    def share_runs(self) -> int:
        """Let images of several threads share runs, if there is a gain; return how many share one, 1 for none."""
        # On a CPU a run of four takes four times as long, and TensorRT builds an engine for each number of images.
        if self.provider == "cuda" and self.inputs[0].shape[0] is None:
            self._shared = self._shared or SharedRuns(self._run_once)
        return IMAGES_A_RUN if self._shared else 1

    def run(self, image: NDArray[Any]) -> list[NDArray[Any]]:
        """Return the outputs, float16 as float32, for an image (1, C, H, W) float32 or uint8; raises `ModelError`."""
        return self._shared.run(image) if self._shared else self._run_once(image)

    def _run_once(self, image: NDArray[Any]) -> list[NDArray[Any]]:
        given = image.astype(np.float16) if self.inputs[0].dtype == "float16" else image
        return self.run_named({self.inputs[0].name: given}, f"an image of {image.shape[3]} x {image.shape[2]}")

    def run_named(self, given: dict[str, NDArray[Any]], what: str) -> list[NDArray[Any]]:
        """Return the outputs for inputs by name; `what` describes them in the message of a `ModelError`."""
        started = time.perf_counter()
        try:
            outputs: Sequence[Any] = self._session.run(None, given)
        except Exception as error:  # its exceptions have no common base
            raise ModelError(f"{self.path} fails on {what}: {error}") from error
        self.last_s = time.perf_counter() - started
        self.total_s += self.last_s
        self.num_runs += 1
        return [o.astype(np.float32) if o.dtype == np.float16 else o for o in map(np.asarray, outputs)]


def available_providers() -> tuple[str, ...]:
    """Return which of `tensorrt`, `cuda`, `cpu` this onnxruntime was built with, the fastest first."""
    import onnxruntime

    built = onnxruntime.get_available_providers()
    return tuple(short for short, name in _NAMES.items() if name in built)


def _session(path: Path, config: NetworkConfig) -> Any:
    import onnxruntime

    built = available_providers()
    if config.provider != "auto" and config.provider not in built:
        raise ModelError(
            f"this onnxruntime has no provider {config.provider}, only {', '.join(built)}; install onnxruntime-gpu in "
            "its place, or choose --set mapper.perception.network.provider=auto"
        )
    chain = [short for short in _CHAINS[config.provider] if short in built]
    providers: list[Any] = [
        _NAMES[short] if short == "cpu" else (_NAMES[short], {"device_id": config.device}) for short in chain
    ]
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = config.threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what matters comes as an exception, and the rest would go past the log
    if not path.is_file():
        raise ModelError(f"{path} is missing")
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=providers)
    except Exception as error:  # its exceptions have no common base
        raise ModelError(_why_not_opened(path, error)) from error
    got = _short(session.get_providers()[0])
    if config.provider not in ("auto", got):
        raise ModelError(
            f"onnxruntime could not start the provider {config.provider} for {path.name} and offers {got}: its "
            "libraries or the device are missing; see onnxruntime's installation notes, or choose provider auto"
        )
    if got != chain[0]:
        logger.warning("%s runs on %s: %s could not be started", path.name, got, chain[0])
    return session


def _why_not_opened(path: Path, error: Exception) -> str:
    text = str(error)
    if "opset" in text.lower():
        what = "was exported for an operator set that this onnxruntime does not know; export it for opset 18"
    elif type(error).__name__ == "InvalidProtobuf" or "protobuf parsing failed" in text.lower():
        what = f"is no whole ONNX file ({path.stat().st_size} bytes): truncated or something else; export it again"
    else:
        what = "is a graph that cannot be run here; export it again"
    return f"{path} {what}; onnxruntime says: {text}"


def _tensor(value: Any) -> Tensor:
    shape = tuple(n if isinstance(n, int) and n > 0 else None for n in value.shape or ())
    return Tensor(name=value.name, shape=shape, dtype=value.type.removeprefix("tensor(").removesuffix(")"))


def _short(name: str) -> str:
    return next((short for short, long in _NAMES.items() if long == name), name)
