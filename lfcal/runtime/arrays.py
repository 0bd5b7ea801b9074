"""Arrays of results: in frozen records, and as text in camera files."""

from __future__ import annotations

import base64
import hashlib
import zlib
from collections.abc import Callable, Hashable, Mapping
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "ENOUGH_LENSES",
    "ENOUGH_PIXELS",
    "LARGEST_BLOCK",
    "MOST",
    "NINE_TENTHS",
    "Array",
    "Booleans",
    "Floats",
    "Frozen",
    "Integers",
    "Singles",
    "decode_array",
    "digest_arrays",
    "encode_array",
    "stretch_contrast",
    "white_of",
]

# Of an array in a camera file [bytes]: the light of three million lenses has 6 MB.
LARGEST_BLOCK = 1 << 28
#: Pixels, and lenses, that statistics of a whole flat are taken of: more do not change them.
ENOUGH_PIXELS = 1_000_000
ENOUGH_LENSES = 4000
#: Quantiles between which nine tenths of values lie, and the middle.
NINE_TENTHS = (0.05, 0.5, 0.95)
#: Percentiles between which the values of a scale lie: errors of single values do not widen it.
MOST = (1, 99)
# Crops of flats are brightened by this gamma: microimages of dark scenes stay visible.
_GAMMA = 1.4
Array = NDArray[Any]
Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]
_Value = TypeVar("_Value")


class Frozen:
    """Base of frozen dataclasses (`eq=False`) whose arrays stay read-only in copies.

    Numba compiles kernels anew for writable arrays: worker processes would have kernels of their
    own, which may add up numbers in another order. In `==`, NaN equals NaN.
    """

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        return type(self), tuple(getattr(self, field.name) for field in fields(self))  # type: ignore[arg-type]

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        compared = (field.name for field in fields(self) if field.compare)  # type: ignore[arg-type]
        return all(_equal(getattr(self, name), getattr(other, name)) for name in compared)

    def derived(self, make: Callable[..., _Value], *key: Hashable) -> _Value:
        """The result of `make(record, *key)`, which is kept until it is made for another key.

        It must not be changed, and must not refer to the record, so that both are freed at once.
        Copies of the record make their own.
        """
        kept: dict[Any, tuple[Any, _Value]] = self.__dict__.setdefault("_derived", {})
        found = kept.get(make)
        if found is None or found[0] != key:
            # Another thread may replace the entry meanwhile.
            found = kept[make] = key, make(self, *key)
        return found[1]

    def _set(self, **values: Any) -> None:
        """Set fields in `__post_init__`, arrays as read-only ones."""
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            object.__setattr__(self, name, value)


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.array_equal(
            one, other, equal_nan=one.dtype.kind == "f" and other.dtype.kind == "f"
        )
    return bool(one == other or (one != one and other != other))


def digest_arrays(arrays: Mapping[str, ArrayLike]) -> str:
    """SHA-256 of arrays, with their names, types and shapes."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        values = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {values.dtype.str} {np.shape(arrays[name])}".encode())
        digest.update(values.reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


def encode_array(values: NDArray[Any]) -> str:
    """An array as text: its bytes, deflated, in base64."""
    return base64.b64encode(zlib.compress(values.tobytes(), 9)).decode("ascii")


def decode_array(text: str, kind: str) -> NDArray[Any]:
    """A flat array of type `kind` from `encode_array`.

    ValueError if the text is damaged or unpacks to too much.
    """
    unpacker = zlib.decompressobj()
    try:
        data = unpacker.decompress(base64.b64decode(text, validate=True), LARGEST_BLOCK)
        if unpacker.unconsumed_tail:
            raise ValueError(f"a packed block has more than {LARGEST_BLOCK / 1e6:.0f} MB")
        if not unpacker.eof:
            raise ValueError("a packed block is cut off")
        return np.frombuffer(data, kind)
    except zlib.error as error:
        raise ValueError(f"a packed block is damaged ({error})") from error


def white_of(pixels: NDArray, white: float | None = None) -> float:
    """The value of white: 1 for floats, the largest value of the type for integers.

    `white`, if it is given and less, replaces the largest value.
    """
    if pixels.dtype.kind == "f":
        return 1.0
    largest = float(np.iinfo(pixels.dtype).max)
    return min(white or largest, largest)


def evenly(count: int, most: float) -> slice:
    """Every k-th of `count` items, so that about `most` of them are left."""
    return slice(None, None, max(1, int(count // most)))


def stretch_contrast(crop: Array) -> NDArray[np.uint8]:
    """A crop of a flat in 8 bits; its darkest per cent is black, its brightest one white."""
    values = np.nan_to_num(crop.astype(np.float32))
    low, high = np.percentile(values, MOST)
    scaled = np.clip((values - low) / max(high - low, 1e-6), 0, 1) ** (1 / _GAMMA)
    shown: NDArray[np.uint8] = np.rint(255 * scaled).astype(np.uint8)
    return shown
