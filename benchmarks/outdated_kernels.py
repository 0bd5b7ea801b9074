"""Delete outdated compiled kernels: `python -m benchmarks.outdated_kernels`.

Numba compiles a kernel again if its own file changes, but not if it calls a function of another
file that changes. Tests and benchmarks delete such kernels first.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

__all__ = ["discard_outdated"]

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


if __name__ == "__main__":
    print(f"{discard_outdated()} indices of kernels were outdated")
