"""Types of arguments are written as plain text, and read again."""

from __future__ import annotations

import json
from importlib import import_module
from typing import NamedTuple

import pytest
from numba import types

from lfcal.runtime.kernels.signatures import decode_type, encode_type, read_signatures


class Pair(NamedTuple):
    a: int
    b: float


@pytest.mark.parametrize(
    "kind",
    [
        types.int64, types.float32, types.boolean, types.none, types.Array(types.uint8, 3, "C"),
        types.Array(types.float64, 1, "A", readonly=True), types.UniTuple(types.int64, 2),
        types.Tuple((types.int64, types.float64)), types.NamedTuple((types.int64, types.float64), Pair),
        types.NamedUniTuple(types.int64, 2, Pair), types.Omitted(3),
    ],
    ids=str,
)  # fmt: skip
def test_types_survive_a_file(kind, monkeypatch):
    monkeypatch.setattr(Pair, "__module__", __name__)
    monkeypatch.setitem(__import__("sys").modules, __name__, __import__("types").SimpleNamespace(Pair=Pair))
    assert decode_type(json.loads(json.dumps(encode_type(kind)))) == kind


def test_types_without_a_name_are_refused():
    with pytest.raises(TypeError):
        encode_type(types.List(types.int64))


def test_listed_kernels_exist():
    listed = {entry[:2] for entry in read_signatures()}
    missing = [f"{module}.{name}" for module, name in listed if not hasattr(import_module(module), name)]
    # Record the list again, with `python -m benchmarks.first_run --record`.
    assert not missing
