"""What a run that takes long keeps beside its output, so that it goes on where it was killed."""

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
    """A hidden folder beside an output with the finished parts of a run; it goes when the output is there.

    Parameters
    ----------
    output : Path
        File or folder that the run is to make.
    """

    def __init__(self, output: Path) -> None:
        self.folder = output.absolute().parent / f".{output.name}.unfinished"
        self._state, self._output = self.folder / "state.json", output
        try:
            self._kept: dict[str, Any] = dict(json.loads(self._state.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            self._kept = {}

    def open(self) -> Path:
        """The folder, made where it is not there."""
        try:
            self.folder.mkdir(exist_ok=True)
        except OSError as error:
            raise OutputError(f"{self._output}: cannot be written ({error.strerror or error})") from error
        return self.folder

    def find(self, name: str, key: str) -> Any:
        """What is kept under a name, if it was made from the same inputs (`key`); else None."""
        found = self._kept.get(name)
        return found["value"] if isinstance(found, dict) and found.get("key") == key else None

    def keep(self, name: str, key: str, value: Any = True) -> None:
        """Keep a value that JSON can hold; files that belong to it must be whole on the disk by now."""
        self.open()
        self._kept[name] = {"key": key, "value": value}
        with atomic_write(self._state) as temporary:
            temporary.write_text(json.dumps(self._kept), encoding="utf-8")

    def remove(self) -> None:
        """Remove the folder."""
        # First what says that the rest is there, should this be interrupted.
        self._kept = {}
        with suppress(OSError):
            self._state.unlink(missing_ok=True)
        shutil.rmtree(self.folder, ignore_errors=True)


def file_identity(path: Path | None) -> list[Any]:
    """Place, size and time of an input, by which another one in its place is told."""
    if path is None:
        return []
    file = path
    if path.is_dir():
        file = next((path / name for name in ("zarr.json", ".zarray", ".zgroup") if (path / name).exists()), path)
    about = os.stat(file)
    return [str(path.absolute()), about.st_size, about.st_mtime_ns]


def fingerprint(*values: Any) -> str:
    """Short text that is another one where any of the values is: numbers, texts, lists of such, or arrays."""
    digest = hashlib.sha256()
    for value in values:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).reshape(-1).view(np.uint8).data)
        else:
            digest.update(json.dumps(value, sort_keys=True).encode())
    return digest.hexdigest()
