"""Types of the arguments that kernels are compiled for, in plain text: lists of them are part of the package.

The file is written by `python -m benchmarks.first_run --record`. An entry that no longer fits its kernel is passed
over, and a kernel that is missing is compiled when it is first called.
"""

from __future__ import annotations

import json
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

__all__ = ["SIGNATURE_FILE", "Signature", "decode_type", "encode_type", "read_signatures", "write_signatures"]

SIGNATURE_FILE = Path(__file__).with_name("signatures.json")


class Signature(NamedTuple):
    """A kernel, and the types of its arguments as `encode_type` writes them."""

    module: str
    name: str
    types: str

    def compile(self) -> None:
        """Compile the kernel for these types, or load it from the cache."""
        kernel = getattr(import_module(self.module), self.name)
        getattr(kernel, "kernel", kernel).compile(tuple(decode_type(entry) for entry in json.loads(self.types)))


def encode_type(kind: Any) -> Any:
    """A type of Numba as text, or a list for arrays and tuples; TypeError for other types."""
    from numba import types

    if isinstance(kind, types.Array):
        if not kind.aligned:
            raise TypeError(f"no name for {kind}")
        return ["array", str(kind.dtype), kind.ndim, kind.layout, kind.mutable]
    if isinstance(kind, types.BaseTuple):
        made_by = getattr(kind, "instance_class", None)
        name = f"{made_by.__module__}:{made_by.__qualname__}" if made_by else ""
        return ["tuple", name, *map(encode_type, _members(kind))]
    if isinstance(kind, types.Omitted):
        return ["omitted", kind.value]
    if isinstance(kind, (types.Integer, types.Float, types.Boolean, types.NoneType)) and not hasattr(
        kind, "literal_value"
    ):
        return str(kind)
    raise TypeError(f"no name for {kind}")


def _members(kind: Any) -> Any:
    return kind.types


def decode_type(entry: Any) -> Any:
    """The type of Numba that `encode_type` has written."""
    from numba import types

    if isinstance(entry, str):
        return types.boolean if entry == "bool" else getattr(types, entry)
    what, *rest = entry
    if what == "array":
        dtype, ndim, layout, mutable = rest
        return types.Array(decode_type(dtype), ndim, layout, readonly=not mutable)
    if what == "omitted":
        return types.Omitted(rest[0])
    name, *items = rest
    members = tuple(map(decode_type, items))
    if not name:
        return types.Tuple(members)
    module, _, qualname = name.partition(":")
    made_by = getattr(import_module(module), qualname)
    same = len(set(members)) == 1
    return types.NamedUniTuple(members[0], len(members), made_by) if same else types.NamedTuple(members, made_by)


@cache
def read_signatures() -> tuple[Signature, ...]:
    """The kernels that Python calls for flats of all kinds, the dearest first."""
    entries = json.loads(SIGNATURE_FILE.read_text(encoding="utf-8"))
    names = [kernel.rpartition(".") for kernel, *_ in entries]
    return tuple(
        Signature(module, name, json.dumps(kinds))
        for (module, _, name), (_, *kinds) in zip(names, entries, strict=True)
    )


def write_signatures(entries: list[tuple[str, str, list[Any]]]) -> None:
    """Write the file: module, name and encoded types of each kernel."""
    rows = ",\n".join(" " + json.dumps([f"{module}.{name}", *kinds]) for module, name, kinds in entries)
    SIGNATURE_FILE.write_text(f"[\n{rows}\n]\n", encoding="utf-8")
