"""A kernel is made anew when anything that its machine code is made of changes, and only then."""

from __future__ import annotations

import sys
from types import ModuleType

import pytest

from lfcal.runtime.kernels.digest import digest_kernel

HELPER = """
from lfcal.runtime.kernels.jit import njit
FACTOR = 3

@njit(cache=True)
def scaled(value):
    return value * FACTOR
"""
KERNEL = """
from lfcal.runtime.kernels.jit import njit
from lfcal_digest_helper import scaled

@njit(cache=True, nogil=True)
def total(values):
    '''Sum of scaled values.'''
    result = 0.0
    for value in values:
        result += scaled(value)
    return result
"""


@pytest.fixture
def digest(monkeypatch):
    """A function for the digest of a kernel in one file that calls one of another file."""

    def make(helper=HELPER, kernel=KERNEL):
        for name, source in (("lfcal_digest_helper", helper), ("lfcal_digest_kernel", kernel)):
            module = ModuleType(name)
            monkeypatch.setitem(sys.modules, name, module)
            exec(compile(source, f"{name}.py", "exec"), module.__dict__)
            for value in vars(module).values():
                if hasattr(value, "py_func") and value.py_func.__module__ == name:
                    value.py_func.__module__ = f"lfcal.{name}"
        return digest_kernel(module.total)

    return make


def test_the_digest_depends_on_nothing_else(digest):
    moved = KERNEL.replace("Sum of scaled values.", "Another docstring.").replace("@njit", "# A comment.\n\n@njit")
    assert digest(HELPER, moved) == digest()


@pytest.mark.parametrize(
    ("old", "new"),
    [("FACTOR = 3", "FACTOR = 4"), ("value * FACTOR", "value + FACTOR"), ("cache=True", "cache=True, fastmath=True")],
)
def test_a_function_of_another_file_changes_the_digest_of_a_kernel_that_calls_it(digest, old, new):
    assert digest(HELPER.replace(old, new)) != digest()


@pytest.mark.parametrize(("old", "new"), [("result = 0.0", "result = 1.0"), ("nogil=True", "nogil=False")])
def test_constants_and_options_change_the_digest(digest, old, new):
    assert digest(HELPER, KERNEL.replace(old, new)) != digest()
