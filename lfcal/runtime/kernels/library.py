"""Libraries of machine code, which is made of a kernel only when Python calls it.

Numba makes machine code of every kernel, with a wrapper for Python, though most are only called by other kernels, which
hold a copy of their intermediate code. And it parses the intermediate code of all that it loads from the cache, though
kernels that Python calls are hardly ever linked again. Either is as much work as all that is needed.
"""

from __future__ import annotations

import sys
from functools import cache
from types import SimpleNamespace
from typing import Any

from llvmlite import binding
from numba.core import environment, lowering
from numba.core.codegen import JITCodeLibrary

from .compilation import compiled_dispatcher

__all__ = ["generate_on_demand"]

_ENVIRONMENT = "_ZN08NumbaEnv"
# Stands for the generator of a library without machine code, which has no place for the address of an environment.
_NO_CODE = SimpleNamespace(set_env=lambda *_: None)


class _Library(JITCodeLibrary):
    """As Numba's own."""

    _bitcode: bytes | None = None
    _object_code = b""
    _waits = False

    @property
    def codegen(self) -> Any:
        return _NO_CODE if self._waits else self._codegen

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = self._waits = True

    def _generate(self) -> None:
        """Make the machine code, or load that of the cache."""
        if not self._waits:
            return
        self._waits = False
        self._dynamic_globals.clear()
        super()._finalize_final_module()
        # Numba has set the environments of the kernels within when it made their own machine code.
        codegen: Any = self._codegen
        names = [found.name for found in self._final_module.global_variables if found.name.startswith(_ENVIRONMENT)]
        for name in names:
            known = environment.lookup_environment(name)
            if known is not None:
                codegen.set_env(name, known)

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        if self._object_code:
            if f"{name}\0".encode() not in self._object_code:
                return 0
            self._generate()
            self._codegen._engine._defined_symbols.add(name)
        elif self._waits:
            if not self._defines(name):
                return 0
            self._generate()
        return int(super().get_pointer_to_function(name))

    def _defines(self, name: str) -> bool:
        try:
            return not self._final_module.get_function(name).is_declaration
        except NameError:
            return False

    def serialize_using_object_code(self) -> tuple[str, str, Any]:
        if self._waits:
            return self.name, "linked", self._get_module_for_linking().as_bitcode()
        found: tuple[str, str, Any] = super().serialize_using_object_code()
        return found

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> Any:
        name, kind, data = state
        library = codegen.create_library(name)
        if kind == "linked":
            library._final_module = library._shared_module = binding.parse_bitcode(data)
        elif kind == "object":
            library._object_code, library._bitcode = data
            library.enable_object_caching()
            library._set_compiled_object(library._object_code)
        else:
            return super()._unserialize(codegen, state)
        library._finalize_final_module()
        return library

    def _get_module_for_linking(self) -> Any:
        if self._bitcode is not None:
            self._shared_module, self._bitcode = binding.parse_bitcode(self._bitcode), None
        return super()._get_module_for_linking()


def _unless_linked(create: Any, also_of_numba: bool) -> Any:
    """Make a wrapper of a kernel, unless it only gets linked with others."""

    def create_wrapper(self: Any, *arguments: Any, **options: Any) -> None:
        dispatcher = compiled_dispatcher()
        linked = getattr(dispatcher, "only_linked", False)
        if not linked and also_of_numba and dispatcher is not None:
            linked = dispatcher.py_func.__module__.startswith("numba.")
        if not linked:
            create(self, *arguments, **options)

    return create_wrapper


def _rebuild_environment(module: str, constants: list[Any], name: str) -> Any:
    """As Numba's own, but without importing the module: the globals of an environment serve its object mode alone."""
    known = environment.lookup_environment(name)
    if known is not None:
        return known
    found = sys.modules.get(module)
    made = environment.Environment(vars(found) if found is not None else {"__name__": module})
    made.consts[:] = constants
    made.env_name = name
    environment.Environment._memo[name] = made
    return made


@cache
def generate_on_demand() -> None:
    """Compile kernels in this way from now on; once per process."""
    from numba.core.registry import cpu_target

    codegen = cpu_target.target_context.codegen()
    if codegen._library_class is JITCodeLibrary:
        codegen._library_class = _Library
        lower: Any = lowering.BaseLower
        # Pickled under its name.
        rebuild: Any = _rebuild_environment
        own: Any = environment._rebuild_env
        rebuild.__module__, rebuild.__name__, rebuild.__qualname__ = own.__module__, own.__name__, own.__qualname__
        environment._rebuild_env = rebuild
        lower.create_cpython_wrapper = _unless_linked(lower.create_cpython_wrapper, also_of_numba=False)
        lower.create_cfunc_wrapper = _unless_linked(lower.create_cfunc_wrapper, also_of_numba=True)
