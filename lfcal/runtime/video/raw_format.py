"""The layout of raw planar video (`.yuv`), which has no header: size, subsampling of the colours, and bits.

They are given, or taken from the name of the file (`Boys2_3976x2956_30fps_420p10.yuv`), from a camera file `.cfg` of
the same name beside it, and, as to the bits, from the samples themselves.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ..errors import FlatError

__all__ = ["RAW_SUFFIX", "RawFormat", "find_raw_format", "parse_pixel_format", "parse_size"]

RAW_SUFFIX = ".yuv"
# Samples of the two colour planes over those of brightness, across and down.
_SHARES = {"400": None, "420": (2, 2), "422": (2, 1), "444": (1, 1)}
_BITS = (8, 10, 12)
# As in MAX_PIXELS of `lfcal.images`: a larger number is no size.
_LARGEST_SIDE = 1 << 20


@dataclass(frozen=True)
class RawFormat:
    """Width and height [px], subsampling ("400", "420", "422" or "444") and bits (8, 10 or 12) of raw video."""

    width: int
    height: int
    subsampling: str
    bits: int

    @property
    def pixel_format(self) -> str:
        """FFmpeg's name of the format, such as `"yuv420p10le"`."""
        deep = f"{self.bits}le" if self.bits > 8 else ""
        return f"gray{deep}" if self.subsampling == "400" else f"yuv{self.subsampling}p{deep}"

    @property
    def frame_bytes(self) -> int:
        """Bytes of one frame."""
        shares = _SHARES[self.subsampling]
        samples = self.width * self.height
        if shares is not None:
            samples += 2 * -(-self.width // shares[0]) * -(-self.height // shares[1])
        return samples * (2 if self.bits > 8 else 1)


def parse_size(text: str) -> tuple[int, int]:
    """Width and height of a text such as `"1920x1080"`; ValueError if it is none."""
    found = re.fullmatch(r"\s*(\d{1,7})[xX](\d{1,7})\s*", text)
    width, height = (int(n) for n in found.groups()) if found else (0, 0)
    if not (0 < width <= _LARGEST_SIDE and 0 < height <= _LARGEST_SIDE):
        raise ValueError(f"a size is WIDTHxHEIGHT in pixels, such as 2048x2048, got {text!r}")
    return width, height


def parse_pixel_format(text: str) -> tuple[str, int]:
    """Subsampling and bits of a name such as `"yuv420p10"`; ValueError if it is none that is read."""
    found = re.fullmatch(r"(?:yuv)?(420|422|444)p?(8|10|12)?(?:le)?|(gray|400p?)(8|10|12)?(?:le)?", text.lower())
    if not found:
        raise ValueError(f"a pixel format is yuv420p, yuv422p, yuv444p or gray, with 10 or 12 for bits, got {text!r}")
    subsampling, bits, _, grey_bits = found.groups()
    return subsampling or "400", int(bits or grey_bits or 8)


def find_raw_format(path: Path, size: tuple[int, int] | None = None, pixel_format: str | None = None) -> RawFormat:
    """The layout of a raw video; what is not given follows from its name, a `.cfg` file beside it, and its samples.

    Raises
    ------
    FlatError
        If the size cannot be told, the pixel format is not known, or the file does not hold a single frame.
    """
    size = size or _size_in_name(path.stem) or _size_beside(path)
    if size is None:
        raise FlatError("raw video has no header; give its size (--size WxH), or name it like NAME_2048x2048.yuv")
    if pixel_format is not None:
        try:
            found = RawFormat(*size, *parse_pixel_format(pixel_format))
        except ValueError as error:
            raise FlatError(str(error)) from error
    else:
        subsampling, bits = _format_in_name(path.stem)
        subsampling = subsampling or "420"
        found = RawFormat(*size, subsampling, bits or _bits_of_samples(path, RawFormat(*size, subsampling, 8)))
    length = path.stat().st_size
    if length < found.frame_bytes:
        raise FlatError(
            f"holds {length} bytes, a frame of {found.width} x {found.height} px {found.pixel_format} has "
            f"{found.frame_bytes}; it is truncated, or --size or --pixel-format are others"
        )
    return found


def _size_in_name(name: str) -> tuple[int, int] | None:
    sizes = re.findall(r"(?<!\d)(\d{2,6})[xX](\d{2,6})(?!\d)", name)
    return parse_size("x".join(sizes[-1])) if sizes else None


def _size_beside(path: Path) -> tuple[int, int] | None:
    """The size in the camera file (key : value) with the same stem."""
    camera = path.with_suffix(".cfg")
    try:
        text = camera.read_text(encoding="utf-8-sig") if camera.stat().st_size < 1 << 16 else ""
    except (OSError, UnicodeDecodeError):
        return None
    found = [re.search(rf"(?m)^\s*Lenslet{side}\s*:\s*(\d+)", text) for side in ("Width", "Height")]
    if found[0] is None or found[1] is None:
        return None
    return parse_size(f"{found[0][1]}x{found[1][1]}")


def _format_in_name(name: str) -> tuple[str | None, int | None]:
    """Subsampling and bits as names of sequences have them: `yuv420p10le`, `420p_10b`, `p444_12bit`, `gray8`."""
    words = re.sub(r"\d{2,6}[xX]\d{2,6}", " ", name.lower())
    words = re.sub(r"(?<![a-z])gr[ae]y(?=(?:8|10|12)(?!\d))", "400p", words)
    subsampling = re.search(r"(?<!\d)(?:yuv|p)?(400|420|422|444)(?!\d)p?(8|10|12)?(?:le)?", words)
    bits = re.search(r"(?<!\d)(8|10|12)[-_ ]?(?:bits?|bpp|b)(?![a-z0-9])", words)
    named = subsampling[2] if subsampling and subsampling[2] else bits[1] if bits else None
    return subsampling[1] if subsampling else None, int(named) if named else None


def _bits_of_samples(path: Path, eight: RawFormat) -> int:
    """Bits of the samples: in 10 or 12 of 16 bits every second byte is small, which it is in no picture of 8."""
    import numpy as np  # not before it is needed: command lines import this module

    if path.stat().st_size < 2 * eight.width * eight.height:
        return 8
    with path.open("rb") as stream:
        data = stream.read(2 * eight.width * eight.height)
    largest = int(np.frombuffer(data, "<u2").max())
    return next((bits for bits in _BITS[1:] if largest < 1 << bits), 8)
