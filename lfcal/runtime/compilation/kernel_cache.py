"""Checksums of compiled kernels: damaged files of Numba's cache are removed before they are loaded.

Numba has no check of its own: after a loss of power, a file that is cut off ends in an error of
every command, and one with other bytes may compute anything.
"""

from __future__ import annotations

import json
import sys
import zlib
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from ..output_file import atomic_write

__all__ = ["record_checksums", "remove_damaged"]


def record_checksums(kernel: Any) -> None:
    """Write the checksums of the files of a kernel beside them."""
    found = {file.name: _checksum(file) for file in _files(kernel)}
    with suppress(OSError), atomic_write(_record(kernel)) as temporary:
        temporary.write_text(json.dumps(found), encoding="utf-8")


def remove_damaged(kernel: Any) -> None:
    """Remove the files of a kernel if one has changed since its checksum was written.

    The kernel is compiled again when it is called, and a note says so. Numba writes the index anew
    with each further type, and all files with a new source: these are no damages.
    """
    record = _record(kernel)
    source = Path(kernel.py_func.__code__.co_filename)
    try:
        known = json.loads(record.read_text(encoding="utf-8"))
        wrong = [name for name, sum_ in known.items() if _checksum(record.with_name(name)) != sum_]
        if not wrong or source.stat().st_mtime > record.stat().st_mtime:
            return
    except (OSError, ValueError):
        return
    files = _files(kernel)
    further = {file.name for file in files} - known.keys()
    if not further or any(name.endswith(".nbc") for name in wrong):
        for one in (*files, record):
            with suppress(OSError):
                one.unlink(missing_ok=True)
        _tell()


def _checksum(file: Path) -> int:
    return zlib.crc32(file.read_bytes())


def _files(kernel: Any) -> list[Path]:
    return sorted(Path(kernel.stats.cache_path).glob(f"{_name(kernel)}-*.nb[ic]"))


def _record(kernel: Any) -> Path:
    return Path(kernel.stats.cache_path, f"{_name(kernel)}.crc.json")


def _name(kernel: Any) -> str:
    function = kernel.py_func
    return f"{Path(function.__code__.co_filename).stem}.{function.__qualname__}"


@cache
def _tell() -> None:
    """Print the note, once for each process."""
    problem = "damaged files of compiled kernels were removed; these kernels are compiled again"
    print(f"note: {problem}", file=sys.stderr)
