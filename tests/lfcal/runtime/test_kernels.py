"""Items of a loop are worked on once each, and kernels round the same in every process, whatever it
has compiled.
"""

from __future__ import annotations

import ast
import inspect
import pkgutil
import sys
import textwrap
import threading
from importlib import import_module
from pathlib import Path

import numba
import numpy as np
import pytest

import lfcal
import lfrender
from lfcal.runtime.kernels import kernel, share_out

ROOT = Path(__file__).parents[3]
PRIVATE = ("numba.core", "llvmlite", "getrefcount", "_nrt", "gc.freeze", "GOMP_SPINCOUNT")


@pytest.fixture(params=[1, 2])
def threads(request):
    before = numba.get_num_threads()
    if request.param > numba.config.NUMBA_NUM_THREADS:
        pytest.skip("one thread only")
    numba.set_num_threads(request.param)
    yield request.param
    numba.set_num_threads(before)


@pytest.mark.parametrize("items", [0, 1, 5, 1000])
def test_each_item_is_worked_on_once(threads, items):
    seen = np.zeros(items, int)
    workers = set()

    def work(begin, end, out):
        out[begin:end] += 1
        workers.add(threading.get_ident())

    share_out(work, items, (seen,))
    assert (seen == 1).all()
    assert len(workers) <= threads


def test_errors_of_all_threads_are_raised(threads):
    def work(begin, end):
        if end == 100:
            raise ValueError("the last item")

    with pytest.raises(ValueError, match="the last item"):
        share_out(work, 100, ())


def test_a_kernel_gets_its_part_as_first_arguments(threads):
    @kernel(share=lambda values, out: len(values))
    def double(begin, end, values, out):
        for k in range(begin, end):
            out[k] = 2 * values[k]

    out = np.zeros(50)
    double(np.arange(50.0), out)
    assert (out == 2 * np.arange(50)).all()


@pytest.mark.parametrize("package", ["lfcal", "lfrender", "data_synth"])
def test_no_private_parts_of_numba_and_python_are_used(package):
    sources = {path: path.read_text(encoding="utf-8") for path in (ROOT / package).rglob("*.py")}
    assert [
        (path.name, part) for path, text in sources.items() for part in PRIVATE if part in text
    ] == []


@pytest.fixture(scope="module")
def kernels():
    """All kernels of both packages, by module and name."""
    for package in (lfcal, lfrender):
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if not module.name.endswith("__main__"):
                import_module(module.name)
    found = {
        (name, key): compiled
        for name, module in sorted(sys.modules.items())
        if name.startswith(("lfcal.", "lfrender."))
        for key, value in vars(module).items()
        if is_kernel(compiled := getattr(value, "kernel", value)) and value.__module__ == name
    }
    assert len(found) > 80
    return found


def is_kernel(value):
    """Whether Numba compiles it."""
    return hasattr(value, "py_func") and hasattr(value, "targetoptions")


def is_inlined(kernel):
    """Whether Numba copies a kernel into its callers, which compiles it with their options."""
    return kernel.targetoptions.get("inline") == "always"


def nodes(kernel):
    return ast.walk(ast.parse(textwrap.dedent(inspect.getsource(kernel.py_func))))


def is_power(node):
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
    for name, compiled in kernels.items():
        if compiled.targetoptions.get("fastmath") or is_inlined(compiled):
            assert not any(map(is_power, nodes(compiled))), (
                f"{name}: replace the power by a product"
            )


def test_kernels_called_with_and_without_fast_math_state_their_own_option(kernels):
    callers = {}
    for name, compiled in kernels.items():
        if not is_inlined(compiled):
            for other in called(compiled):
                callers.setdefault(other, {})[name] = bool(compiled.targetoptions.get("fastmath"))
    for compiled, fast in callers.items():
        if "fastmath" not in compiled.targetoptions:
            assert len(set(fast.values())) == 1, (
                f"{compiled.py_func.__qualname__}: state fastmath=False; {fast}"
            )
