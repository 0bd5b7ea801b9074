"""Machine code of kernels from the cache, without the intermediate code that comes with it until someone needs that.

Numba parses the intermediate code of all that it loads, so that other kernels may be linked with it, and lists its
symbols: as much work as to load the machine code. Kernels that Python calls are hardly ever linked again.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from llvmlite import binding
from numba.core.codegen import JITCodeLibrary

__all__ = ["link_on_demand"]


class _Library(JITCodeLibrary):
    """As Numba's own."""

    _bitcode: bytes | None = None
    _object_code = b""

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> Any:
        name, kind, data = state
        if kind != "object":
            return super()._unserialize(codegen, state)
        library = codegen.create_library(name)
        library._object_code, library._bitcode = data
        library.enable_object_caching()
        library._set_compiled_object(library._object_code)
        library._finalize_final_module()
        return library

    def _get_module_for_linking(self) -> Any:
        if self._bitcode is not None:
            self._shared_module, self._bitcode = binding.parse_bitcode(self._bitcode), None
        return super()._get_module_for_linking()

    def get_pointer_to_function(self, name: str) -> int:
        if self._object_code and f"{name}\0".encode() in self._object_code:
            self._codegen._engine._defined_symbols.add(name)
        return int(super().get_pointer_to_function(name))


@cache
def link_on_demand() -> None:
    """Load kernels in this way from now on; once per process."""
    from numba.core.registry import cpu_target

    codegen = cpu_target.target_context.codegen()
    if codegen._library_class is JITCodeLibrary:
        codegen._library_class = _Library
