"""Interpolation along a run of pixels that lie a whole pixel apart, so that all have the same four weights."""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.fastmath import FAST

__all__ = ["BUNCH", "GAIN_BITS", "TOGETHER", "copy_run", "padded_length", "read_run", "read_run_of_bytes"]

#: Fractional bits of a gain below 4 in 16 bits.
GAIN_BITS = 14
# Fractional bits of the upper half of its product with a byte weighted by 256ths.
_LEFT_BITS = 6
#: Bytes that are read together.
TOGETHER = 16
#: Values that are read together, as vector instructions want it; those beyond the end of a run are overwritten.
BUNCH = 32


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _weights_of_bytes(fx, fy):
    """Weights of the four pixels about a place in whole 256ths, rounded so that their sum is 256 whatever they are."""
    right, low = np.rint(256 * fx), np.rint(256 * fy)
    corner = np.rint(right * low / 256)
    return (
        np.uint16(256 - right - low + corner), np.uint16(right - corner), np.uint16(low - corner), np.uint16(corner),
    )  # fmt: skip


# Python's error model checks every division, which no vector loop can.
@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def read_run(flat, at, across, down, fx, fy, gain, gain_at, half, top, out, start, size):
    """Interpolate a run of values, times the gain if there is one, rounded by adding `half`.

    Places are unsigned: signed ones are checked for being counted from the end.
    """
    at_b, at_c, at_d = at + across, at + down, at + down + across
    wa, wb, wc = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy
    wd = fx * fy
    for k in range(size):
        value = wa * np.float32(flat[at + k]) + wb * np.float32(flat[at_b + k])
        value += wc * np.float32(flat[at_c + k]) + wd * np.float32(flat[at_d + k])
        if len(gain) > 0:
            value *= gain[gain_at + k]
        out[start + k] = min(value + half, top)


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def read_run_of_bytes(flat, at, across, down, fx, fy, gain, gain_at, out, start, size):
    """The same for bytes, with weights in 256ths: twice as many at a time."""
    at_b, at_c, at_d = at + across, at + down, at + down + across
    wa, wb, wc, wd = _weights_of_bytes(fx, fy)
    half, left_half = np.uint16(128), np.uint16(1 << (_LEFT_BITS - 1))
    if len(gain) == 0:
        for k in range(size):
            value = np.uint16(wa * flat[at + k] + wb * flat[at_b + k] + wc * flat[at_c + k] + wd * flat[at_d + k])
            out[start + k] = np.uint16(value + half) >> np.uint16(8)
    else:
        for k in range(size):
            value = np.uint16(wa * flat[at + k] + wb * flat[at_b + k] + wc * flat[at_c + k] + wd * flat[at_d + k])
            value = np.uint16((np.uint32(value) * np.uint32(gain[gain_at + k])) >> np.uint32(16))
            value = np.uint16(value + left_half) >> np.uint16(_LEFT_BITS)
            out[start + k] = min(value, np.uint16(255))


@njit(inline="always")
def padded_length(length, bunch, overlap):
    """Values to read for a run: at least a bunch, and a whole number of them unless they may `overlap`."""
    return max(length, bunch) if overlap else (length + bunch - np.uint64(1)) // bunch * bunch


@njit
def copy_run(line, row, first, last, channels, turned):
    """Copy the pixels of `line` from `first` to `last` into `row`, in reverse order if `turned`."""
    if not turned:
        for k in range(first * channels, last * channels):
            row[k] = line[k]
    elif channels == 3:
        one = np.uint64(1)
        # Faster than the loop below, since the compiler knows the step.
        for k in range(last - first):
            target, source = np.uint64(3 * (last - 1 - k)), np.uint64(3 * (first + k))
            row[target], row[target + one] = line[source], line[source + one]
            row[target + one + one] = line[source + one + one]
    else:
        for k in range(last - first):
            for c in range(channels):
                row[(last - 1 - k) * channels + c] = line[(first + k) * channels + c]
