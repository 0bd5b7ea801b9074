"""Intermediate results beside the output of a long run, from which a killed run is continued."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from lfcal import OutputError
from lfcal.runtime.output_file import atomic_write

__all__ = ["Checkpoint", "file_identity", "fingerprint"]


class Checkpoint:
    """A hidden folder with the finished parts of a run, removed when the output is there."""

    def __init__(self, output: Path) -> None:
        self.folder = output.absolute().parent / f".{output.name}.unfinished"
        self._state, self._output = self.folder / "state.json", output
        try:
            self._kept: dict[str, Any] = dict(json.loads(self._state.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            self._kept = {}

    def open(self) -> Path:
        """The folder, made where it does not exist."""
        try:
            self.folder.mkdir(exist_ok=True)
        except OSError as error:
            raise OutputError(
                f"{self._output}: cannot be written ({error.strerror or error})"
            ) from error
        return self.folder

    def find(self, name: str, key: str) -> Any:
        """The value kept under a name, if it was made from the same inputs (`key`); else None."""
        found = self._kept.get(name)
        return found["value"] if isinstance(found, dict) and found.get("key") == key else None

    def keep(self, name: str, key: str, value: Any = True) -> None:
        """Keep a value that JSON can hold; files that belong to it must be complete."""
        self.open()
        self._kept[name] = {"key": key, "value": value}
        with atomic_write(self._state) as temporary:
            temporary.write_text(json.dumps(self._kept), encoding="utf-8")

    def remove(self) -> None:
        """Remove the folder."""
        # The state goes first: without it, files that an interruption here leaves behind are not
        # used.
        self._kept = {}
        with suppress(OSError):
            self._state.unlink(missing_ok=True)
        shutil.rmtree(self.folder, ignore_errors=True)


def file_identity(path: Path | None) -> list[Any]:
    """Path, size and time of an input file or Zarr folder, which tell it from others."""
    if path is None:
        return []
    names = ("zarr.json", ".zarray", ".zgroup") if path.is_dir() else ()
    about = os.stat(next((path / name for name in names if (path / name).exists()), path))
    return [str(path.absolute()), about.st_size, about.st_mtime_ns]


def fingerprint(*values: Any) -> str:
    """SHA-256 of numbers, texts, lists of such, and arrays."""
    digest = hashlib.sha256()
    for value in values:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        else:
            digest.update(json.dumps(value, sort_keys=True).encode())
    return digest.hexdigest()
