"""Compiled kernels of developers: delete outdated ones, list those that users compile ahead.

`python -m benchmarks.kernels [--record]`. Numba compiles a kernel again if its own file changes,
but not if it calls a function of another file that changes. Tests and benchmarks delete such
kernels first. `--record` writes the list of kernels that the first command compiles
(`lfcal/runtime/compilation/signatures.json`).
"""

from __future__ import annotations

import ast
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

__all__ = ["cached_kernels", "discard_outdated", "encode_type"]

_ROOT = Path(__file__).parents[1]
_PACKAGES = ("lfcal", "lfrender", "data_synth")


def discard_outdated() -> int:
    """Delete the cache of each module that is older than the module or one that it imports; returns
    how many.
    """
    count = 0
    for package in _PACKAGES:
        for source in (_ROOT / package).rglob("*.py"):
            given = os.environ.get("NUMBA_CACHE_DIR")
            folders = Path(given).glob("*") if given else [source.parent / "__pycache__"]
            for index in (
                file for folder in folders for file in folder.glob(f"{source.stem}.*.nbi")
            ):
                if index.stat().st_mtime < max(file.stat().st_mtime for file in _needed(source)):
                    index.unlink(missing_ok=True)
                    # Its checksums too: the next kernel has others.
                    record = index.with_name(f"{index.name.partition('-')[0]}.crc.json")
                    record.unlink(missing_ok=True)
                    count += 1
    return count


@cache
def _needed(source: Path) -> frozenset[Path]:
    """A module and all modules of the packages that it imports, directly or not."""
    found = {source}
    waiting = [source]
    while waiting:
        new = set(_imports(waiting.pop())) - found
        found |= new
        waiting += new
    return frozenset(found)


@cache
def _imports(source: Path) -> tuple[Path, ...]:
    return tuple(_find_imports(source))


def _find_imports(source: Path) -> Iterator[Path]:
    parts = source.relative_to(_ROOT).parts
    for node in ast.parse(source.read_text(encoding="utf-8")).body:
        if not isinstance(node, ast.ImportFrom):
            continue
        name = (node.module or "").split(".") if node.module else []
        base = _ROOT.joinpath(*parts[: len(parts) - node.level] if node.level else (), *name)
        for path in (base.with_suffix(".py"), *(base / f"{entry.name}.py" for entry in node.names)):
            if path.is_file() and path.is_relative_to(_ROOT):
                yield path


def _record() -> None:
    """Compile the kernels for flats of each kind in an empty cache, and write their list."""
    import lfcal
    import lfrender
    from lfcal.runtime.compilation.compile_ahead import SIGNATURE_FILE
    from lfrender.web.report_pictures import draw_pictures

    from .first_run import CAPTURES, KINDS, simulate_kind

    for options in ({}, *KINDS.values()):
        settings: dict[str, Any] = {"lattice": "hex", "focus": 0.04, "size": (700, 560), **options}
        capture = simulate_kind(**settings)
        camera = lfcal.calibrate(capture.flat)
        lfcal.calibrate(capture.white, kind="white")
        for preset in ("fast", "balanced"):
            depth = lfrender.analyze(capture.flat, camera, preset)
        lfrender.render(capture.flat, camera, depth)
        draw_pictures(capture.flat, camera, depth)
    if CAPTURES.exists():
        # A real capture has noise and three types of lenses.
        flat = lfcal.read_flat(CAPTURES / "Fujita2.png")
        camera = lfcal.calibrate(flat)
        lfrender.render(flat, camera, lfrender.analyze(flat, camera))
    found = []
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in ("data_synth", "lfcal", "lfrender"):
            for kernel in cached_kernels(module):
                code = kernel.inspect_asm()
                found += [
                    (len(code[types]), (name, kernel.__name__, list(types)))
                    for types in kernel.signatures
                ]
    # The longest are the dearest.
    found.sort(key=lambda entry: -entry[0])
    rows = [
        json.dumps([f"{module}.{name}", *map(encode_type, types)])
        for _, (module, name, types) in found
    ]
    SIGNATURE_FILE.write_text("[\n " + ",\n ".join(rows) + "\n]\n", encoding="utf-8")
    print(f"{len(found)} kernels")


def encode_type(kind: Any) -> Any:
    """A type of Numba as `lfcal.runtime.compilation.compile_ahead.decode_type` reads it."""
    from numba import types

    if isinstance(kind, types.Array):
        return ["array", str(kind.dtype), kind.ndim, kind.layout, kind.mutable]
    if not isinstance(kind, types.BaseTuple):
        return str(kind)
    made_by = getattr(kind, "instance_class", None)
    name = made_by and f"{made_by.__module__}:{made_by.__qualname__}"
    members: Any = kind
    return ["tuple", name or "", *map(encode_type, members)]


def cached_kernels(module: Any) -> list[Any]:
    """The kernels of a module that Numba caches: those that Python calls."""
    kernels = [getattr(value, "kernel", value) for value in vars(module).values()]
    return [
        kernel
        for kernel in kernels
        if hasattr(kernel, "py_func")
        and kernel.__module__ == module.__name__
        and kernel.stats.cache_path
    ]


if __name__ == "__main__":
    if "--record" in sys.argv:
        with tempfile.TemporaryDirectory() as name:
            os.environ["NUMBA_CACHE_DIR"] = name
            _record()
    else:
        print(f"{discard_outdated()} indices of kernels were outdated")
