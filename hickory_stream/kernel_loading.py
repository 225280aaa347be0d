"""Loading of compiled kernels without what only a compiler needs of them.

Beside its machine code numba keeps a kernel's bitcode, for kernels that call it and are compiled later. It parses that
whenever it loads one, and lists all symbols in it: a third of what loading takes. Here that waits until somebody asks.
It reaches into numba, so that it is done for the releases that it was tried on, and for no others.
"""

from __future__ import annotations

from typing import Any

import numba
from llvmlite import binding
from numba.core import codegen

_TRIED = "0.68."
_WAITING = "_hickory_bitcode"
# The entry point of a kernel, which its machine code has.
_ENTRY = "_ZN7cpython"


def load_lazily() -> None:
    """Have numba load kernels so, from now on; a release that this was not tried on loads as it does."""
    if not numba.__version__.startswith(_TRIED):
        return
    library = codegen.JITCodeLibrary
    whole_unserialize = library._unserialize.__func__
    whole_module = library._get_module_for_linking
    whole_pointer = library.get_pointer_to_function

    def unserialize(cls: Any, generator: Any, state: Any) -> Any:
        name, kind, data = state
        if kind != "object":
            return whole_unserialize(cls, generator, state)
        machine_code, bitcode = data
        own = generator.create_library(name)
        own.enable_object_caching()
        own._set_compiled_object(machine_code)
        own._finalize_final_module()
        setattr(own, _WAITING, bitcode)
        return own

    def module_for_linking(self: Any) -> Any:
        _parse(self)
        return whole_module(self)

    def pointer_to_function(self: Any, name: str) -> Any:
        if name.startswith(_ENTRY) and hasattr(self, _WAITING):
            return self._codegen._engine.get_function_address(name)
        _parse(self)
        return whole_pointer(self, name)

    library._unserialize = classmethod(unserialize)
    library._get_module_for_linking = module_for_linking
    library.get_pointer_to_function = pointer_to_function


def _parse(library: Any) -> None:
    """Do for a library what was left out when it was loaded."""
    bitcode = library.__dict__.get(_WAITING)
    if bitcode is not None:
        library._shared_module = binding.parse_bitcode(bitcode)
        library._codegen._engine._load_defined_symbols(library._shared_module)
        library.__dict__.pop(_WAITING, None)
