"""Arrays as text in camera files."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["decode_array", "encode_array"]


def encode_array(values: NDArray[Any]) -> str:
    """An array as text: its bytes, deflated, in base64."""
    return base64.b64encode(zlib.compress(values.tobytes(), 9)).decode("ascii")


def decode_array(text: str, kind: str) -> NDArray[Any]:
    """A flat array of type `kind` from `encode_array`; ValueError where the text is damaged."""
    try:
        return np.frombuffer(zlib.decompress(base64.b64decode(text, validate=True)), kind)
    except zlib.error as error:
        raise ValueError(f"a packed block is damaged ({error})") from error
