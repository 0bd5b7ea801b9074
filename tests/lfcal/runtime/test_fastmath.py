"""Kernels round the same in every process, whatever it has compiled."""

from __future__ import annotations

import ast
import inspect
import pkgutil
import sys
import textwrap
from importlib import import_module

import pytest

import lfcal
import lfrender


@pytest.fixture(scope="module")
def kernels():
    """All kernels of both packages, by module and name."""
    for package in (lfcal, lfrender):
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if not module.name.endswith("__main__"):
                import_module(module.name)
    found = {
        (name, key): getattr(value, "kernel", value)
        for name, module in sorted(sys.modules.items())
        if name.startswith(("lfcal.", "lfrender."))
        for key, value in vars(module).items()
        if is_kernel(getattr(value, "kernel", value)) and value.__module__ == name
    }
    assert len(found) > 150
    return found


def is_kernel(value):
    """Whether Numba compiles it."""
    return hasattr(value, "py_func") and hasattr(value, "targetoptions")


def is_inlined(kernel):
    """Whether Numba copies a kernel into its callers, which compiles it with their options."""
    return kernel.targetoptions.get("inline") == "always"


def nodes(kernel):
    """All nodes of the syntax tree of a kernel."""
    return ast.walk(ast.parse(textwrap.dedent(inspect.getsource(kernel.py_func))))


def is_power(node):
    """Whether a node raises to a power, with an operator or by a function."""
    if isinstance(node, ast.Call):
        return getattr(node.func, "attr", getattr(node.func, "id", "")) in ("pow", "power", "hypot")
    return isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.Pow)


def called(kernel):
    """Kernels that a kernel calls, also through kernels that Numba copies into it."""
    for node in nodes(kernel):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            other = kernel.py_func.__globals__.get(node.func.id)
            if is_kernel(other):
                yield from called(other) if is_inlined(other) else [other]


def test_kernels_with_fast_math_have_products_instead_of_powers(kernels):
    for name, kernel in kernels.items():
        if kernel.targetoptions.get("fastmath") or is_inlined(kernel):
            assert not any(map(is_power, nodes(kernel))), f"{name}: replace the power by a product"


def test_kernels_called_with_and_without_fast_math_state_their_own_option(kernels):
    callers = {}
    for name, kernel in kernels.items():
        if not is_inlined(kernel):
            for other in called(kernel):
                callers.setdefault(other, {})[name] = bool(kernel.targetoptions.get("fastmath"))
    assert sum("fastmath" in kernel.targetoptions for kernel in callers) > 30
    for kernel, fast in callers.items():
        if "fastmath" not in kernel.targetoptions:
            assert len(set(fast.values())) == 1, f"{kernel.py_func.__qualname__}: state fastmath=False; {fast}"
