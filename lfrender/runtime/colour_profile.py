"""ICC profiles that say whether values are linear or sRGB, and what the profile of a flat says.

Profiles have the primaries of sRGB (IEC 61966-2-1), or are grey, and are built as ICC.1:2010
(version 4) describes them.
"""

from __future__ import annotations

import struct
from functools import cache

import numpy as np

__all__ = ["colour_profile", "is_linear_profile"]

# Columns of red, green and blue of sRGB, and white, all adapted to the illuminant D50 [XYZ].
_COLUMNS = {
    b"rXYZ": (0.4360747, 0.2225045, 0.0139322),
    b"gXYZ": (0.3850649, 0.7168786, 0.0971045),
    b"bXYZ": (0.1430804, 0.0606169, 0.7141733),
}
_D50 = (0.9642029, 1.0, 0.8249054)
# Gamma, a, b, c and d of the curve of sRGB, a parametric curve of type 3.
_SRGB = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
_HEAD = 128  # [bytes]
_ENTRY = 12  # [bytes] of a tag in the table


def _fixed(*values: float) -> bytes:
    """Numbers with 16 bits behind the point."""
    return np.rint(np.multiply(values, 65536)).astype(">i4").tobytes()


def _text(words: str) -> bytes:
    """A text in English, as a tag."""
    data = words.encode("utf-16-be")
    return b"mluc" + struct.pack(">IIIHHII", 0, 1, 12, 0x656E, 0x5553, len(data), 28) + data


@cache
def colour_profile(channels: int, encoded: bool) -> bytes:
    """The profile of pictures of so many channels: grey below 3, else with the primaries of sRGB.

    Its curve is that of sRGB if values are `encoded`, else they are in proportion to light.
    """
    curve = b"curv" + struct.pack(">II", 0, 0)
    if encoded:
        curve = b"para" + struct.pack(">IHH", 0, 3, 0) + _fixed(*_SRGB)
    name = "sRGB" if encoded else "linear light"
    tags = {
        b"desc": _text(f"lfrender {name}"),
        b"cprt": _text("CC0"),
        b"wtpt": b"XYZ " + bytes(4) + _fixed(*_D50),
    }
    space = b"GRAY"
    if channels >= 3:
        space = b"RGB "
        tags |= {tag: b"XYZ " + bytes(4) + _fixed(*column) for tag, column in _COLUMNS.items()}
        tags |= {b"rTRC": curve, b"gTRC": curve, b"bTRC": curve}
    else:
        tags[b"kTRC"] = curve
    table = struct.pack(">I", len(tags))
    body = b""
    start = _HEAD + len(table) + _ENTRY * len(tags)
    for tag, data in tags.items():
        table += tag + struct.pack(">II", start + len(body), len(data))
        body += data + bytes(-len(data) % 4)
    head = struct.pack(
        ">I4sI4s4s4s", start + len(body), bytes(4), 0x04200000, b"mntr", space, b"XYZ "
    )
    head += struct.pack(">6H4s", 2026, 1, 1, 0, 0, 0, b"acsp")
    # Platform to creator: nothing but the white of the connection space at its place.
    head += bytes(28) + _fixed(*_D50)
    return head.ljust(_HEAD, b"\0") + table + body


def is_linear_profile(icc: bytes) -> bool:
    """Whether the values of a picture with this profile are in proportion to light."""
    try:
        count = struct.unpack_from(">I", icc, _HEAD)[0]
        for k in range(min(count, 100)):
            tag, start, _ = struct.unpack_from(">4sII", icc, _HEAD + 4 + _ENTRY * k)
            if tag not in (b"rTRC", b"kTRC"):
                continue
            if icc[start : start + 4] == b"curv":
                points, gamma = struct.unpack_from(">IH", icc[start + 8 :] + bytes(2))
                return bool(points == 0 or (points == 1 and gamma == 256))
            kind, _, gamma = struct.unpack_from(">HHi", icc, start + 8)
            return bool(kind == 0 and gamma == 65536)
    # A damaged profile tells nothing.
    except struct.error:
        pass
    return False
