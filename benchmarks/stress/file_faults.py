"""Damaged and hostile files for every reader: truncated, bits flipped, wrong headers or types."""

from __future__ import annotations

import io
import json
import resource
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile

import lfcal
import lfrender
from lfcal.camera_files.read_write import convert
from lfrender.sequence.film_file import FilmFile
from lfrender.sequence.frames import open_frames

from .plane_flats import PlaneFlat

__all__ = ["Fault", "damaged", "fuzz", "limit_memory", "whole_files"]

_SIZE = (160, 120)
# A reader may take so long [s] over a file of a hundred kilobytes at most.
_TIME = 2.0
_HEADER = 300
_MOST_FRAMES = 1000
_CLAIMS = (
    b"\xff\xff\xff\xff",
    b"\x7f\xff\xff\xff",
    b"\0\0\0\0",
    b"\xff\xff\xff\x7f",
    b"1e99",
    b"null",
    b"-999",
    b"NaN,",
)


@dataclass(frozen=True)
class Fault:
    """A file that was not refused: its name, the number of the damage, and the result."""

    name: str
    number: int
    what: str


def whole_files(folder: Path) -> dict[str, bytes]:
    """One good file of every kind that is read, by its name; the suffix tells the reader."""
    grey = (PlaneFlat(size=_SIZE, fill=0.95).flat() >> 8).astype(np.uint8)
    files = {
        f"flat{suffix}": _encoded(suffix, grey)
        for suffix in (".png", ".tif", ".webp", ".bmp", ".pgm", ".jpg")
    }
    colour = np.repeat(grey[..., None], 3, 2)
    files["colour.png"] = _encoded(".png", colour)
    files["deep.png"] = _encoded(".png", colour.astype(np.uint16) * np.uint16(257))
    variants: tuple[tuple[str, Any, dict[str, Any]], ...] = (
        ("tiles", grey, {"tile": (32, 32), "compression": "zlib"}),
        ("float", grey.astype(np.float32), {}),
        ("lzw", colour, {"compression": "lzw", "photometric": "rgb"}),
        ("zstd", grey, {"compression": "zstd", "rowsperstrip": 50}),
        ("packbits", grey, {"compression": "packbits", "photometric": "miniswhite"}),
        ("jpeg", colour, {"compression": "jpeg", "photometric": "rgb"}),
    )
    for name, pixels, options in variants:
        stream = io.BytesIO()
        tifffile.imwrite(stream, pixels, **options)
        files[f"{name}.tif"] = stream.getvalue()
    files |= _container_files(folder, grey)
    shot = PlaneFlat(size=_SIZE)
    lfrender.analyze(shot.flat(), shot.calibration).save(folder / "depth.npz")
    camera = lfcal.calibrate(
        PlaneFlat(size=_SIZE, pitch=12.0, contrast=0.0, noise=0.01, fill=0.95).flat()
    )
    camera.save(folder / "camera.json")
    for suffix in (".xml", ".cfg", ".csv"):
        convert(camera, folder / f"camera{suffix}")
    for suffix in (".mp4", ".mkv") if find_spec("av") else ():
        with FilmFile(folder / f"film{suffix}", Fraction(25)) as film:
            for step in range(4):
                film.add(np.roll(colour, step, 1))
    return files | {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def _container_files(folder: Path, grey: Any) -> dict[str, bytes]:
    """Files of the readers of containers whose packages are installed."""
    files = {}
    wide = grey.astype(np.uint16) << 4
    stream = io.BytesIO()
    tifffile.imwrite(stream, grey, ome=True, metadata={"axes": "YX"})
    files["ome.tif"] = stream.getvalue()
    files["film_160x120_400p8.yuv"] = grey.tobytes() * 2
    # A Lytro file of one picture: a table of contents, its description, and packed pixels of 12
    # bits.
    pairs = wide.reshape(-1, 2)
    packed = np.stack(
        [pairs[:, 0] >> 4, (pairs[:, 0] & 15) << 4 | pairs[:, 1] >> 8, pairs[:, 1] & 255], 1
    )
    about = {"image": {"width": _SIZE[0], "height": _SIZE[1], "pixelPacking": {"bitsPerPixel": 12}}}
    names = {"imageRef": "sha1-" + "a" * 40, "metadataRef": "sha1-" + "b" * 40}
    blobs = [packed.astype(np.uint8).tobytes(), json.dumps(about).encode()]
    sections = [
        (b"\x89LFM", "sha1-" + "c" * 40, json.dumps({"frames": [{"frame": names}]}).encode())
    ]
    sections += [(b"\x89LFC", name, blob) for name, blob in zip(names.values(), blobs, strict=True)]
    lytro = struct.pack(">4s4sII", b"\x89LFP", b"\r\n\x1a\n", 1, 0)
    for kind, name, blob in sections:
        head = struct.pack(">4s4sII", kind, b"\r\n\x1a\n", 0, len(blob)) + name.encode().ljust(
            80, b"\0"
        )
        lytro += (head + blob).ljust(-(-len(head + blob) // 16) * 16, b"\0")
    files["picture.lfr"] = lytro
    if find_spec("h5py"):
        import h5py

        with h5py.File(folder / "views.h5", "w") as file:
            file.create_dataset(
                "LF", data=grey.reshape(4, 30, 5, 32).transpose(0, 2, 1, 3), compression="gzip"
            )
        files["views.h5"] = (folder / "views.h5").read_bytes()
        (folder / "views.h5").unlink()
    if find_spec("OpenEXR"):
        import OpenEXR

        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"Y": grey.astype(np.float32)}).write(str(folder / "grey.exr"))
        files["grey.exr"] = (folder / "grey.exr").read_bytes()
        (folder / "grey.exr").unlink()
    if find_spec("rawpy"):
        tags = [
            (33421, "H", 2, (2, 2), True),
            (33422, "B", 4, (0, 1, 1, 2), True),
            (50706, "B", 4, (1, 4, 0, 0), True),
            (50708, "s", 5, "None", True),
            (50714, "H", 1, 0, True),
            (50717, "H", 1, 4095, True),
        ]
        stream = io.BytesIO()
        tifffile.imwrite(stream, wide, photometric="CFA", extratags=tags, metadata=None)
        files["photo.dng"] = stream.getvalue()
    return files


def _encoded(suffix: str, pixels: Any) -> bytes:
    return bytes(cv2.imencode(suffix, pixels)[1].tobytes())


def damaged(whole: bytes, number: int) -> bytes:
    """`whole` with the damage of that number: of five kinds in turn, at random places."""
    rng = np.random.default_rng(number)
    data = bytearray(whole)
    kind = number % 5
    if kind == 0:
        return bytes(data[: rng.integers(0, len(data))])
    if kind == 1:
        for _ in range(rng.integers(1, 6)):
            data[rng.integers(0, len(data))] ^= 1 << int(rng.integers(0, 8))
    elif kind == 2:
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(0, min(len(data), _HEADER))] = rng.integers(0, 256)
    elif kind == 3:
        start = int(rng.integers(0, len(data)))
        length = int(rng.integers(1, 64))
        data[start : start + length] = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
    else:
        start = int(rng.integers(0, min(len(data) - 4, _HEADER)))
        data[start : start + 4] = _CLAIMS[rng.integers(len(_CLAIMS))]
    return bytes(data)


def _read_film(path: Path) -> int:
    """Read all frames, then the last one alone, and raise the first error."""
    errors: list[lfcal.LightFieldError] = []
    count = 0
    try:
        lfcal.read_flat(path, 3)
    except lfcal.LightFieldError as error:
        errors.append(error)
    for frame in islice(open_frames([path]), _MOST_FRAMES):
        try:
            frame.read()
        except lfcal.LightFieldError as error:
            errors.append(error)
        count += 1
    if errors:
        raise errors[0]
    if count == _MOST_FRAMES:
        raise RuntimeError("a film of four frames has no end")
    return count


def _reader(name: str) -> Callable[[Path], Any]:
    suffix = Path(name).suffix
    if suffix in (".mp4", ".mkv"):
        return _read_film
    if suffix == ".npz":
        return lfrender.DepthMap.load
    if suffix in (".json", ".xml", ".cfg", ".csv"):
        # A camera is of use only where its lenses can be counted.
        return lambda path: len(lfcal.load(path, None if suffix == ".json" else _SIZE).lattice)
    return lambda path: (
        lfcal.count_pages(path),
        lfcal.read_flat(path, 0 if suffix == ".yuv" else None),
    )


def fuzz(
    folder: Path, numbers: range, more: dict[str, bytes] | None = None
) -> tuple[int, list[Fault]]:
    """Read every kind of file with the damages of these numbers.

    Returns
    -------
    tried : int
    faults : list of Fault
        Errors that are none of the project's own, and reads that took longer than two seconds of
        CPU time. What is read without an error holds together as far as its format lets anybody
        tell.
    """
    good = folder / "whole"
    good.mkdir()
    faults = []
    tried = 0
    for name, whole in (whole_files(good) | (more or {})).items():
        # With its name, from which the size of raw video follows.
        read = _reader(name)
        path = folder / f"damaged_{name}"
        for number in numbers:
            path.write_bytes(damaged(whole, number))
            start = time.process_time()
            what = ""
            try:
                read(path)
            except lfcal.LightFieldError as error:
                if str(path) not in str(error):
                    what = f"the file is not named: {error}"
            except Exception as error:
                what = repr(error)[:200]
            spent = time.process_time() - start
            what = what or ("" if spent < _TIME else f"{spent:.1f} s")
            if what:
                faults.append(Fault(name, number, what))
            tried += 1
    return tried, faults


def limit_memory(gigabytes: float) -> None:
    """Limit the address space of this process, so that a header cannot claim more."""
    resource.setrlimit(
        resource.RLIMIT_AS, (int(gigabytes * 2**30), resource.getrlimit(resource.RLIMIT_AS)[1])
    )
