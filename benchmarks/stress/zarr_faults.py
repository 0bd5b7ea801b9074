"""Damaged and hostile Zarr arrays: files truncated, altered or missing, wrong descriptions."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfcal

from .file_faults import Fault, damaged

__all__ = ["PICTURE", "described_otherwise", "fuzz_arrays", "whole_arrays"]

# An array may keep a reader busy so long [s].
_TIME = 1.0
#: What all good arrays hold; no pixel is that which Zarr takes where it finds none.
PICTURE: NDArray[np.uint8] = np.random.default_rng(0).integers(1, 255, (60, 70, 3), dtype=np.uint8)


def whole_arrays(folder: Path) -> dict[str, Path]:
    """One good array for each way in which a flat may be stored."""
    import numcodecs
    import zarr
    from zarr.codecs import BloscCodec

    ways: dict[str, dict[str, Any]] = {
        "v2": {"zarr_format": 2},
        "v2 plain": {"zarr_format": 2, "compressors": None},
        "v2 blosc": {"zarr_format": 2, "compressors": numcodecs.Blosc("lz4")},
        "v3": {"zarr_format": 3},
        "v3 plain": {"zarr_format": 3, "compressors": None},
        "v3 blosc": {"zarr_format": 3, "compressors": BloscCodec()},
        "v3 shards": {"zarr_format": 3, "chunks": (16, 16, 3), "shards": (32, 32, 3)},
    }
    found = {}
    for name, options in ways.items():
        found[name] = folder / f"{name}.zarr"
        array = zarr.create_array(
            found[name], shape=PICTURE.shape, dtype="uint8", **{"chunks": (32, 32, 3), **options}
        )
        array[...] = PICTURE
    return found


def _part(path: Path) -> NDArray[Any]:
    with lfcal.open_flat(path) as source:
        height, width = source.shape[:2]
        return source.read(0, 0, min(width, 70), min(height, 60))


def _harmed(whole: Path, number: int) -> Iterator[tuple[str, Callable[[Path], Any]]]:
    """Copies of an array whose files are damaged in turn, or one is removed."""
    rng = np.random.default_rng(number)
    files = sorted(
        f.relative_to(whole) for f in whole.rglob("*") if f.is_file() and f.stat().st_size > 8
    )
    head = [file for file in files if file.name in (".zarray", "zarr.json")]
    for kind, some in (("description", head), ("chunk", sorted(set(files) - set(head)))):
        file = some[rng.integers(len(some))]
        yield f"{kind} damaged", partial(_damage, file, number)
        yield f"{kind} missing", partial(_remove, file)


def _damage(file: Path, number: int, copy: Path) -> None:
    (copy / file).write_bytes(damaged((copy / file).read_bytes(), number))


def _remove(file: Path, copy: Path) -> None:
    (copy / file).unlink()


def fuzz_arrays(folder: Path, numbers: range) -> tuple[int, list[Fault]]:
    """Read every kind of array with the damages of these numbers.

    Returns
    -------
    tried : int
    faults : list of Fault
        Errors that are none of the project's own, reads that took longer than a second of CPU time,
        and pictures that were read although a file was missing or a chunk was cut off.
    """
    good = folder / "whole"
    good.mkdir()
    faults = []
    tried = 0
    for name, whole in whole_arrays(good).items():
        for number in numbers:
            for what, harm in _harmed(whole, number):
                copy = folder / "damaged.zarr"
                shutil.rmtree(copy, ignore_errors=True)
                shutil.copytree(whole, copy)
                harm(copy)
                # The first kind of damage cuts a file off.
                refused = "missing" in what or (what == "chunk damaged" and number % 5 == 0)
                for read in (lfcal.read_flat, _part):
                    tried += 1
                    fault = _fault(copy, read, refused)
                    if fault:
                        faults.append(Fault(f"{name}, {what}", number, fault))
    return tried, faults


def _fault(path: Path, read: Callable[[Path], NDArray[Any]], refused: bool) -> str:
    start = time.process_time()
    try:
        pixels = read(path)
        wrong = pixels.shape != PICTURE.shape or not np.array_equal(pixels, PICTURE)
        fault = "another picture was read" if refused and wrong else ""
    except lfcal.LightFieldError as error:
        fault = "" if str(path) in str(error) else f"the file is not named: {error}"
    except Exception as error:
        fault = repr(error)[:200]
    spent = time.process_time() - start
    return fault or ("" if spent < _TIME else f"{spent:.1f} s")


def described_otherwise(path: Path, **entries: Any) -> None:
    """Change entries in the description of an array."""
    file = next(path / name for name in (".zarray", "zarr.json") if (path / name).exists())
    file.write_text(
        json.dumps(json.loads(file.read_text(encoding="utf-8")) | entries), encoding="utf-8"
    )
