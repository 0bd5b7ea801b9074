"""Mismatch of the views of a small patch of the scene, at some depth, through the lenses around it.

The most central lenses are compared on 3 x 3 samples, each normalised by contrast; the mean over the better part of the
views is robust against occlusion.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numba import njit

from .settings import SURFACE, SurfaceSettings

__all__ = ["MAX_VIEWS", "WORK", "sample_views", "view_constants", "view_mismatch"]

#: Only so many lenses, the most central ones, are compared.
MAX_VIEWS = 6
# Each of so many views is compared with all others: the first may be occluded.
_REFERENCES = 2
# Views are the lanes of one vector register. Their values lie known distances apart in one array, so that the compiler
# combines them into vector instructions: 4 x 4 pixels, fractions, 3 x 3 samples, their moments, and mismatches. No
# order of sums is left to the compiler.
_EIGHT = np.uint64(8)
_FX, _FY = np.uint64(128), np.uint64(136)
_P0, _P1, _P2, _P3, _P4, _P5, _P6, _P7, _P8 = (np.uint64(144 + 8 * k) for k in range(9))
_MEAN, _VARIANCE, _COST = np.uint64(216), np.uint64(224), np.uint64(232)
#: Float32 values of work memory for one depth, finite: from place `base` of `work` on.
WORK = 240

# Float32 values of `SurfaceSettings`, the radius of a microimage [px], and the mismatch `floor` that noise
# explains.
ViewConstants = namedtuple("ViewConstants", "unknown occluded_views radius floor")


def view_constants(radius: float, floor: float, settings: SurfaceSettings = SURFACE) -> ViewConstants:
    named = (getattr(settings, name) for name in ViewConstants._fields[:2])
    return ViewConstants(*map(np.float32, (*named, radius, floor)))


@njit(error_model="numpy")
def _fetch(pixels, stride, px, py, work, lane):
    """Put the 4 x 4 pixels about (px, py) into the place `lane` of `work` and every eighth on, and its fractions."""
    i, j = int(px), int(py)
    at, into = np.uint64(j - 1) * stride + np.uint64(i - 1), lane
    for _ in range(4):
        for k in range(np.uint64(4)):
            work[into + k * _EIGHT] = pixels[at + k]
        at += stride
        into += np.uint64(4) * _EIGHT
    work[lane + _FX], work[lane + _FY] = px - np.float32(i), py - np.float32(j)


@njit(error_model="numpy", inline="always")
def _between(work, at, fx):
    """Three values between the four pixels of a row."""
    a, b, c, d = work[at], work[at + _EIGHT], work[at + np.uint64(16)], work[at + np.uint64(24)]
    return a + fx * (b - a), b + fx * (c - b), c + fx * (d - c)


@njit(error_model="numpy")
def _interpolate(work, base):
    """The 3 x 3 samples about the place of each lane, their mean and variance; those a pixel apart share their weights,
    and most pixels."""
    ninth = np.float32(1 / 9)
    for m in range(_EIGHT):
        at = base + m
        fx, fy = work[at + _FX], work[at + _FY]
        left0, middle0, right0 = _between(work, at, fx)
        left1, middle1, right1 = _between(work, at + np.uint64(32), fx)
        left2, middle2, right2 = _between(work, at + np.uint64(64), fx)
        left3, middle3, right3 = _between(work, at + np.uint64(96), fx)
        p0, p1, p2 = left0 + fy * (left1 - left0), middle0 + fy * (middle1 - middle0), right0 + fy * (right1 - right0)
        p3, p4, p5 = left1 + fy * (left2 - left1), middle1 + fy * (middle2 - middle1), right1 + fy * (right2 - right1)
        p6, p7, p8 = left2 + fy * (left3 - left2), middle2 + fy * (middle3 - middle2), right2 + fy * (right3 - right2)
        work[at + _P0], work[at + _P1], work[at + _P2] = p0, p1, p2
        work[at + _P3], work[at + _P4], work[at + _P5] = p3, p4, p5
        work[at + _P6], work[at + _P7], work[at + _P8] = p6, p7, p8
        mean = ninth * (((p0 + p1) + (p2 + p3)) + ((p4 + p5) + (p6 + p7)) + p8)
        squares = ((p0 * p0 + p1 * p1) + (p2 * p2 + p3 * p3)) + ((p4 * p4 + p5 * p5) + (p6 * p6 + p7 * p7)) + p8 * p8
        work[at + _MEAN] = mean
        work[at + _VARIANCE] = max(ninth * squares - mean * mean, np.float32(0.0))


@njit(error_model="numpy")
def _compare(work, base, r, unknown, floor):
    """Mismatch of the samples of each lane with those of lane `r`."""
    ninth, half = np.float32(1 / 9), unknown * floor
    mean, variance = work[base + _MEAN + r], work[base + _VARIANCE + r] + floor
    r0, r1, r2 = work[base + _P0 + r], work[base + _P1 + r], work[base + _P2 + r]
    r3, r4, r5 = work[base + _P3 + r], work[base + _P4 + r], work[base + _P5 + r]
    r6, r7, r8 = work[base + _P6 + r], work[base + _P7 + r], work[base + _P8 + r]
    for m in range(_EIGHT):
        d0, d1, d2 = work[base + _P0 + m] - r0, work[base + _P1 + m] - r1, work[base + _P2 + m] - r2
        d3, d4, d5 = work[base + _P3 + m] - r3, work[base + _P4 + m] - r4, work[base + _P5 + m] - r5
        d6, d7, d8 = work[base + _P6 + m] - r6, work[base + _P7 + m] - r7, work[base + _P8 + m] - r8
        squares = ((d0 * d0 + d1 * d1) + (d2 * d2 + d3 * d3)) + ((d4 * d4 + d5 * d5) + (d6 * d6 + d7 * d7)) + d8 * d8
        apart = mean - work[base + _MEAN + m]
        work[base + _COST + m] = (ninth * squares + half) / (work[base + _VARIANCE + m] + variance + apart * apart)


@njit(error_model="numpy", inline="always")
def _ordered(a, b):
    return min(a, b), max(a, b)


@njit(error_model="numpy")
def _mean_of_best(work, base, views, r, number):
    """Mean of the `number` smallest costs of `views` lanes except `r`."""
    work[base + _COST + r] = np.inf
    for m in range(np.uint64(views), np.uint64(MAX_VIEWS)):
        work[base + _COST + m] = np.inf
    a, b, c = work[base + _COST], work[base + _COST + np.uint64(1)], work[base + _COST + np.uint64(2)]
    d, e, f = work[base + _COST + np.uint64(3)], work[base + _COST + np.uint64(4)], work[base + _COST + np.uint64(5)]
    # A sorting network of six values, without branches that the processor would mispredict.
    a, b = _ordered(a, b)
    c, d = _ordered(c, d)
    e, f = _ordered(e, f)
    a, c = _ordered(a, c)
    d, f = _ordered(d, f)
    b, e = _ordered(b, e)
    a, b = _ordered(a, b)
    c, d = _ordered(c, d)
    e, f = _ordered(e, f)
    b, c = _ordered(b, c)
    d, e = _ordered(d, e)
    c, d = _ordered(c, d)
    total = a
    if number > 1:
        total += b
    if number > 2:
        total += c
    if number > 3:
        total += d
    return total / np.float32(number)


@njit(error_model="numpy")
def sample_views(image, near_x, near_y, work, radius, count, x, y, slope, base):
    """Put the pixels of the first `count` lenses at scene point (x, y), at depth `slope` = s / D, into `work`.

    The lenses have their centres at `near_x`, `near_y`, the nearest first. Returns how many lenses, of this `radius`,
    show the point; the first counts in any case.
    """
    height, width = image.shape
    pixels, one = image.reshape(-1), np.float32(1.0)
    right, bottom = np.float32(width) - np.float32(2.001), np.float32(height) - np.float32(2.001)
    seen = 0
    for m in range(count):
        dx, dy = -(x - near_x[m]) * slope, -(y - near_y[m]) * slope
        # Those after it are farther.
        if m > 0 and dx * dx + dy * dy > radius * radius:
            break
        px, py = min(max(near_x[m] + dx, one), right), min(max(near_y[m] + dy, one), bottom)
        _fetch(pixels, np.uint64(width), px, py, work, base + np.uint64(m))
        seen += 1
    return seen


@njit(error_model="numpy")
def view_mismatch(work, constants, nearest, seen, base):
    """Mean mismatch of the better part of the `seen` views found by `sample_views` with one of the most central.

    0 for equal views, about 1 for unrelated ones. Behind another depth, where views may be occluded, a mismatch tells
    less than at the `nearest` one.
    """
    unknown = constants.unknown
    if seen < 2:
        return unknown
    _interpolate(work, base)
    # Half of the others: an occluder may hide the rest.
    number = seen // 2
    least = np.float32(np.inf)
    for r in range(np.uint64(_REFERENCES)):
        _compare(work, base, r, unknown, constants.floor)
        least = min(least, _mean_of_best(work, base, seen, r, number))
    if not nearest and least > unknown:
        least = unknown + (least - unknown) * np.float32(seen) / (np.float32(seen) + constants.occluded_views)
    return least
