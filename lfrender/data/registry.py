"""Captures of a lab, served from a folder or a server with a list of their hashes (pooch)."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from lfcal import FlatError, read_flat
from lfcal.runtime.arrays import Array
from lfcal.runtime.output_file import atomic_write
from lfcal.runtime.packages import import_package

from ..runtime.types import AnyPath
from .samples import cache_folder

__all__ = ["Registry", "open_registry", "write_registry"]


@dataclass(frozen=True)
class Registry:
    """Files in a folder or at an address `base`, with their `hashes` (`sha256:...`) by name.

    `open_registry` makes one.

    Examples
    --------
    >>> import tempfile, lfrender
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/flat.png", lfrender.data.example()[0])
    ...     _ = lfrender.data.write_registry(folder)
    ...     lab = lfrender.data.open_registry(folder)
    ...     lab.names, lab.read("flat.png").shape
    (['flat.png'], (180, 240, 3))
    """

    base: str
    hashes: dict[str, str]

    @property
    def names(self) -> list[str]:
        """Names of the files."""
        return sorted(self.hashes)

    def fetch(self, name: str) -> Path:
        """The path of a file, which is fetched into the cache if it is not there.

        FlatError if the file is missing or its hash is not the listed one.
        """
        if name not in self.hashes:
            raise FlatError(
                f"{name}: is not in the registry at {self.base}; it has {', '.join(self.names[:8])}"
            )
        pooch = import_package("pooch", "registries need", FlatError)
        address = self.base.rstrip("/") + "/"
        place = cache_folder() / "fetched" / hashlib.sha256(self.base.encode()).hexdigest()[:12]
        store = pooch.create(path=place, base_url=address, registry=self.hashes)
        pooch.get_logger().setLevel("WARNING")
        copy = None if "://" in self.base else lambda url, target, _: shutil.copyfile(url, target)
        try:
            return Path(store.fetch(name, downloader=copy))
        except (OSError, ValueError) as error:
            raise FlatError(
                f"{address}{name}: cannot be fetched ({' '.join(str(error).split())})"
            ) from error

    def read(self, name: str, page: int | None = None) -> Array:
        """The pixels of a file, as `lfcal.read_flat`."""
        return read_flat(self.fetch(name), page)


def open_registry(base: AnyPath, hashes: Mapping[str, str] | AnyPath | None = None) -> Registry:
    """The registry of a folder or an address; FlatError if its list cannot be read.

    `hashes` are those by name, or the list with them: by default `registry.txt` in the folder. For
    an address it must be given, since a list from the same server would prove nothing.

    Examples
    --------
    >>> import lfrender
    >>> lfrender.data.open_registry("captures", {"flat.png": "sha256:" + 64 * "0"}).names
    ['flat.png']
    """
    place = os.fspath(base)
    if isinstance(hashes, Mapping):
        return Registry(place, dict(hashes))
    if hashes is None and "://" in place:
        raise FlatError(
            f"{place}: give the list of hashes too (hashes='registry.txt'); write_registry makes it"
        )
    path = Path(place) / "registry.txt" if hashes is None else Path(hashes)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FlatError(f"{path}: cannot be read as a list of hashes ({error})") from error
    found = {}
    for number, line in enumerate(lines, 1):
        name, _, value = line.rpartition(" ")
        if (
            not re.fullmatch(r"sha256:[0-9a-f]{64}", value)
            or ".." in Path(name).parts
            or Path(name).is_absolute()
        ):
            raise FlatError(
                f"{path}: line {number} is not 'NAME sha256:HASH'; write_registry makes the list"
            )
        found[name] = value
    return Registry(place, found)


def write_registry(folder: AnyPath) -> Path:
    """Write `registry.txt` with the hashes of all files but hidden ones; returns its path.

    Examples
    --------
    >>> import tempfile, lfrender
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     lfrender.data.write_registry(folder).name
    'registry.txt'
    """
    target = Path(folder) / "registry.txt"
    lines = []
    for path in sorted(Path(folder).rglob("*")):
        name = path.relative_to(folder)
        if (
            path.is_file()
            and path != target
            and not any(part.startswith(".") for part in name.parts)
        ):
            lines.append(
                f"{name.as_posix()} sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}\n"
            )
    with atomic_write(target) as temporary:
        temporary.write_text("".join(lines), encoding="utf-8")
    return target
