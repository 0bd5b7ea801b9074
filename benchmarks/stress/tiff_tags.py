"""TIFF files with changed tags: `python -m benchmarks.stress.tiff_tags [COUNT] [SEED]`.

Each file has one changed number in its tags, or is cut off. It is refused in one line, or read with
the same pixels; else its tags and bytes make another picture, and the kinds of these are counted.
"""

from __future__ import annotations

import io
import struct
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

import lfcal

__all__ = ["damage", "fuzz_tags", "main", "tiff_kinds"]

_COMPRESSIONS = (None, "lzw", "zlib", "packbits", "zstd", "lzma", "jpeg", "png", "webp")
_IMAGES = ("jpegxl", "jpeg2000")
# Width, length, bits, compression, photometric, samples, rows of strips, planes, predictor, sides of
# tiles, extra samples, sample format, byte counts and offsets.
_TAGS = (256, 257, 258, 259, 262, 277, 278, 284, 317, 322, 323, 338, 339, 279, 325, 273)
# Values of compressions, colours and bits that are in use.
_SMALL = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 24, 32)
_KNOWN = (*_SMALL, 32773, 32803, 32946, 33003, 34712, 34892, 34925, 34933, 50000, 50001, 50002)
# Share of the files that are cut off.
_CUT = 0.1


def tiff_kinds() -> dict[str, tuple[bytes, NDArray[Any]]]:
    """Good files by their kinds, with their pixels."""
    y, x = np.mgrid[:48, :64]
    noise = np.random.default_rng(1).integers(0, 9, (48, 64, 3))
    colour = (np.stack([x * 3, y * 4, 200 - x * 2], -1) + noise).astype(np.uint8)
    grey = colour[..., 0]
    files = {}
    for compression in (*_COMPRESSIONS, *_IMAGES):
        for name, pixels in (("grey", grey), ("rgb", colour)):
            for bits in (8, 16):
                if bits == 16 and compression in ("jpeg", "webp"):
                    continue
                if compression == "webp" and name == "grey":
                    continue
                deep = pixels if bits == 8 else pixels.astype(np.uint16) * np.uint16(253)
                tile = (16, 32) if name == "rgb" and bits == 16 else None
                options: dict[str, Any] = {"compression": compression, "tile": tile}
                if compression in ("lzw", "zlib", "zstd") and name == "rgb":
                    options["predictor"] = True
                if tile is None:
                    options["rowsperstrip"] = 13
                stream = io.BytesIO()
                photometric = "rgb" if name == "rgb" else "minisblack"
                tifffile.imwrite(stream, deep, photometric=photometric, metadata=None, **options)
                files[f"{compression} {name} {bits}"] = (stream.getvalue(), deep)
    return files


def damage(whole: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """A file with one other number in its tags, or without its end, and what was changed."""
    if rng.random() < _CUT:
        return whole[: rng.integers(8, len(whole))], "cut"
    with tifffile.TiffFile(io.BytesIO(whole)) as tiff:
        tags = tiff.pages[0].tags  # type: ignore[union-attr]
        code = int(rng.choice([code for code in _TAGS if code in tags]))
        tag: Any = tags[code]
    old = tag.value[0] if isinstance(tag.value, tuple) else int(tag.value)
    near = (old - 1, old + 1, old * 2, old // 2, old * 3, 1, 2)
    values = [int(value) for value in (*near, *_KNOWN) if 0 <= value < 1 << 16 and value != old]
    value = int(rng.choice(values))
    width = {3: 2, 4: 4}[int(tag.dtype)]
    data = bytearray(whole)
    repeated = tag.count if code == 258 else 1
    for k in range(repeated):
        at = tag.valueoffset + k * width
        data[at : at + width] = struct.pack("<H" if width == 2 else "<I", value)
    return bytes(data), f"{tag.name} {old} -> {value}"


def fuzz_tags(count: int, seed: int = 0) -> tuple[int, list[str], list[str]]:
    """Numbers of refused files, files with other pixels, and faults, by kind and change."""
    rng = np.random.default_rng(seed)
    kinds = tiff_kinds()
    names = list(kinds)
    refused = 0
    others = []
    faults = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flat.tif"
        path.write_bytes(b"")
        good = {}
        for name in names:
            path.write_bytes(kinds[name][0])
            good[name] = lfcal.read_flat(path)
        for _ in range(count):
            name = names[rng.integers(len(names))]
            data, what = damage(kinds[name][0], rng)
            path.write_bytes(data)
            try:
                flat = lfcal.read_flat(path)
                lfcal.open_flat(path).close()
            except lfcal.FlatError as error:
                refused += 1
                if len(str(error).splitlines()) != 1:
                    faults.append(f"{name}, {what}: {error!r}")
            except Exception as error:
                faults.append(f"{name}, {what}: {error!r}")
            else:
                if not np.array_equal(flat, good[name]):
                    others.append(f"{name}, {what}")
    return refused, others, faults


def main(arguments: list[str]) -> None:
    """Print figures; exit with 1 if there is a fault."""
    count, seed = (*map(int, arguments), *(2000, 0)[len(arguments) :])[:2]
    refused, others, faults = fuzz_tags(count, seed)
    print(f"{count} files, {refused} refused, {len(others)} with other pixels:")
    for what, number in sorted(Counter(others).items()):
        print(f"{number:4d}  {what}")
    print("\n".join(faults))
    sys.exit(bool(faults))


if __name__ == "__main__":
    main(sys.argv[1:])
