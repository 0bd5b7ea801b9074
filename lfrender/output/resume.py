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

from lfcal.runtime.output_file import atomic_write, output_errors

from ..runtime.types import Entries

__all__ = ["Checkpoint", "file_identity", "fingerprint"]


class Checkpoint:
    """What one stage of a run has finished, in a hidden folder that goes when the output is there.

    Results are found again if `inputs` are the same; `fingerprint` says what they may be.
    """

    def __init__(self, output: Path, stage: str, *inputs: Any) -> None:
        self.folder = output.absolute().parent / f".{output.name}.unfinished"
        self._output = output
        self._stage = stage
        self._key = fingerprint(*inputs)
        self._state = self.folder / "state.json"
        self._kept: dict[str, Entries] = {}
        with suppress(OSError, ValueError, TypeError):
            self._kept = dict(json.loads(self._state.read_text(encoding="utf-8")))

    @property
    def found(self) -> Any:
        """The value that an earlier run has kept, else None."""
        kept = self._kept.get(self._stage, {})
        if kept.get("key") == self._key:
            return kept["value"]
        return None

    def open(self) -> Path:
        """The folder, made where it does not exist."""
        with output_errors(self._output):
            self.folder.mkdir(exist_ok=True)
        return self.folder

    def keep(self, value: Any = True) -> None:
        """Keep a value that JSON can hold; files that belong to it must be complete."""
        self.open()
        self._kept[self._stage] = {"key": self._key, "value": value}
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


def file_identity(path: Path) -> list[Any]:
    """Path, size and time of an input file or Zarr folder, which distinguish it from others."""
    names = ("zarr.json", ".zarray", ".zgroup") if path.is_dir() else ()
    about = os.stat(next((path / name for name in names if (path / name).exists()), path))
    return [str(path.absolute()), about.st_size, about.st_mtime_ns]


def fingerprint(*values: Any) -> str:
    """SHA-256 of numbers, texts, lists of such, arrays, and the identities of files (paths)."""
    digest = hashlib.sha256()
    for value in values:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
            continue
        plain = file_identity(value) if isinstance(value, Path) else value
        digest.update(json.dumps(plain, sort_keys=True).encode())
    return digest.hexdigest()
