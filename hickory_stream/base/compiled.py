"""The `kernel` decorator: numba kernels, cached by a hash of all their sources.

numba compares only a function's own file, and writes beside modules, which an installation may forbid. Here the name of
a kernel's folder is a hash of its file and of all files that it takes kernels and constants from.
"""

import contextlib
import hashlib
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numba
import numpy as np
from llvmlite import binding
from numba.core import environment, event
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.runtime import rtsys

from hickory_stream.base import compiling
from hickory_stream.base.caches import cache_folder, cache_root, mark_used, wanted_root

__all__ = ["KernelLocator", "compiler_name", "kernel", "kernels_folder", "numba", "source_hash"]

# The ray caster brings a TBB that is too old for numba, which warns of it.
numba.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

_OURS = ("hickory_stream", "players")
_IMPORT = re.compile(rf"^from ((?:{'|'.join(_OURS)})[\w.]*) import (\([^)]*\)|.*)", re.MULTILINE)
_HAS_KERNELS = re.compile(r"^@kernel\b", re.MULTILINE)
_CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]*")


class KernelLocator:
    """Locates the cached kernels of our packages; has the interface of numba's own locators."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._py_file = py_file
        self._line = py_func.__code__.co_firstlineno
        self._stamp = source_hash(py_func.__module__, Path(py_file))
        self._folder = kernels_folder() / f"{py_func.__module__}-{self._stamp[:16]}"
        mark_used(self._folder)

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> "KernelLocator | None":
        """Return the locator of a function; None for foreign functions, or without a file."""
        if not _is_ours(py_func) or not Path(py_file).is_file():
            return None
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Return the state of the source for which the kernel was compiled."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """Return the distinction of functions of one name."""
        return str(self._line)

    def ensure_cache_path(self) -> None:
        """Make the folder; raises `OSError`."""
        self._folder.mkdir(parents=True, exist_ok=True)


def kernel(
    function: Callable[..., Any] | None = None,
    *,
    error_model: Literal["python", "numpy"] = "python",
    parallel: bool = False,
) -> Any:
    """Compile a function of arrays and numbers, without the interpreter's lock, and cache it.

    `error_model` "numpy" divides by zero without an error, which lets the compiler vectorise. `parallel` spreads loops
    over `numba.prange` over threads.
    """
    if function is None:
        return lambda function: kernel(function, error_model=error_model, parallel=parallel)
    compiled = numba.njit(nogil=True, error_model=error_model, parallel=parallel)(function)
    if not numba.config.DISABLE_JIT:
        compiled._cache = _KernelCache(function)
    return compiled


class _KernelCache:
    """numba's cache of a kernel, opened at its first call, which loads nothing that only a compiler needs.

    numba imports all of its implementations before it loads a kernel. It does so again before it compiles one.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    @cached_property
    def _opened(self) -> Any:
        return FunctionCache(self._function)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return a cached kernel; None if there is none."""
        rtsys.initialize(context)
        context.codegen().unserialize_library = partial(_LoadedLibrary.unserialized, context.codegen())
        with self._opened._guard_against_spurious_io_errors():
            return self._opened._load_overload(signature, context)

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Cache a kernel; on a full disk it is compiled again by the next process."""
        with contextlib.suppress(OSError):
            self._opened.save_overload(signature, compiled)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._opened, name)


class _LoadedLibrary(JITCodeLibrary):  # type: ignore[misc] # numba has no types
    """Machine code of a cached kernel; its bitcode is parsed when a kernel is compiled that calls it."""

    @classmethod
    def unserialized(cls, codegen: Any, state: tuple[str, str, Any]) -> Any:
        """Return a library from its cached state; the machine code is ready."""
        name, kind, data = state
        if kind != "object":
            return codegen._library_class._unserialize(codegen, state)
        loaded = cls(codegen, name)
        machine_code, loaded._bitcode = data
        loaded.enable_object_caching()
        loaded._set_compiled_object(machine_code)
        loaded._finalize_final_module()
        return loaded

    def _get_module_for_linking(self) -> Any:
        if not hasattr(self, "_parsed"):
            self._parsed = binding.parse_bitcode(self._bitcode)
            self._codegen._engine._load_defined_symbols(self._parsed)
        return self._parsed

    def get_pointer_to_function(self, name: str) -> Any:
        return self._codegen._engine.get_function_address(name)


def _environment(module: str, constants: list[Any], name: str) -> environment.Environment:
    # That of a cached kernel: no module is imported for the globals, which machine code does not use.
    found = environment.lookup_environment(name)
    if found is None:
        found = environment.Environment._memo[name] = environment.Environment({"__name__": module})
        found.consts[:], found.env_name = constants, name
    return found


@cache
def kernels_folder() -> Path:
    """Return the folder of the kernels of this compiler."""
    folder = cache_folder("kernels") / compiler_name()
    kept = wanted_root() / "kernels" / compiler_name()
    if wanted_root() != cache_root() and not folder.exists() and kept.is_dir():
        # Compiled while the installation was made, and read-only since: what is there need not be compiled again.
        with contextlib.suppress(OSError):
            partial = Path(tempfile.mkdtemp(prefix=".", dir=folder.parent))
            shutil.copytree(kept, partial, dirs_exist_ok=True)
            partial.rename(folder)
    return folder


def compiler_name() -> str:
    """Return the versions that a kernel's file depends on; the processor is in the file."""
    return f"py{sys.version_info[0]}{sys.version_info[1]}-numba{numba.__version__}-numpy{np.__version__}"


@cache
def source_hash(module: str, file: Path) -> str:
    """Return the sha256 of a module's file and of the files whose kernels and constants it may use."""
    base = file.parents[module.count(".") + (file.stem == "__init__")]
    known: dict[Path, bytes] = {}
    waiting = [file]
    while waiting:
        path = waiting.pop()
        if path not in known:
            known[path], needed = _read(path, base)
            waiting += needed
    digest = hashlib.sha256()
    for path in sorted(known):
        digest.update(path.relative_to(base).as_posix().encode() + known[path])
    return digest.hexdigest()


@cache
def _read(file: Path, base: Path) -> tuple[bytes, tuple[Path, ...]]:
    # The hash of a file, and the files whose kernels and constants it may use.
    needed: list[Path] = []
    content = file.read_bytes()
    for module, listed in _IMPORT.findall(content.decode()):
        names = re.findall(r"\w+", re.sub(r"#.*| as \w+", "", listed))
        folder = base.joinpath(*module.split("."))
        needed += [path for name in names if (path := folder / f"{name}.py").is_file()]
        source = folder.with_suffix(".py")
        if source.is_file() and (any(_CONSTANT.fullmatch(name) for name in names) or _has_kernels(source)):
            needed.append(source)
    return hashlib.sha256(content).digest(), tuple(needed)


@cache
def _has_kernels(file: Path) -> bool:
    return _HAS_KERNELS.search(file.read_text(encoding="utf-8")) is not None


def _is_ours(function: Callable[..., Any]) -> bool:
    return function.__module__.partition(".")[0] in _OURS


class _Compiles(event.Listener):  # type: ignore[misc] # numba has no types
    def on_start(self, event: Any) -> None:
        function = event.data["dispatcher"].py_func
        if _is_ours(function):
            compiling.compile_begins(f"{function.__module__}.{function.__qualname__}")

    def on_end(self, event: Any) -> None:
        del event


if not numba.config.CACHE_LOCATOR_CLASSES:
    # Ours first, then numba's defaults.
    numba.config.CACHE_LOCATOR_CLASSES = (
        "hickory_stream.base.compiled.KernelLocator,UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,"
        "IPythonCacheLocator,ZipCacheLocator"
    )
environment._rebuild_env = _environment
event.register("numba:compile", _Compiles())
