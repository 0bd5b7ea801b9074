"""Box filters on planes of voxels: what one pixel of a flat averages over.

A pixel averages over the aperture of its microlens (one pitch), over its own width, and over the
blur of diffraction. Each is a box along both axes, of any width; several in a row come near to a
Gaussian. A box filter with zeros around the plane is a symmetric matrix, so it
is its own adjoint; several in a row are so except near the border, where they do not commute.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.kernels import kernel

__all__ = ["blur", "blur_planes"]


@njit(fastmath=False)
def _blur_rows(plane, width, line):
    """Box of a `width` [voxels] above 1 along x, in place; `line` (w,) is scratch."""
    height, columns = plane.shape
    half = (width - 1.0) / 2.0
    whole = int(half)
    part = half - whole
    for y in range(height):
        total = 0.0
        for x in range(columns):
            line[x] = plane[y, x]
        for x in range(min(whole, columns)):
            total += line[x]
        for x in range(columns):
            enters = x + whole
            leaves = x - whole - 1
            if enters < columns:
                total += line[enters]
            if leaves >= 0:
                total -= line[leaves]
            edge = 0.0
            if leaves >= 0:
                edge += line[leaves]
            if enters + 1 < columns:
                edge += line[enters + 1]
            plane[y, x] = (total + part * edge) / width


@njit(fastmath=False)
def _blur_columns(plane, width, copy, totals):
    """Blur along y by a box of `width` [voxels] above 1, in place.

    `copy` (h, w) and `totals` (w,) float64 are scratch.
    """
    height, columns = plane.shape
    half = (width - 1.0) / 2.0
    whole = int(half)
    part = half - whole
    copy[:] = plane
    totals[:] = 0.0
    for y in range(min(whole, height)):
        for x in range(columns):
            totals[x] += copy[y, x]
    for y in range(height):
        enters = y + whole
        leaves = y - whole - 1
        if enters < height:
            for x in range(columns):
                totals[x] += copy[enters, x]
        if leaves >= 0:
            for x in range(columns):
                totals[x] -= copy[leaves, x]
        for x in range(columns):
            plane[y, x] = totals[x] / width
        if leaves >= 0:
            for x in range(columns):
                plane[y, x] += part * copy[leaves, x] / width
        if enters + 1 < height:
            for x in range(columns):
                plane[y, x] += part * copy[enters + 1, x] / width


@njit(fastmath=False)
def blur(plane, widths):
    """Blur along both axes by boxes of all `widths` (k,) [voxels], in place.

    Boxes up to 1 leave the plane as it is.
    """
    copy = np.empty_like(plane)
    line = np.empty(plane.shape[1], plane.dtype)
    totals = np.empty(plane.shape[1], np.float64)
    for width in widths:
        if width > 1.0:
            _blur_rows(plane, width, line)
            _blur_columns(plane, width, copy, totals)


@kernel(share=lambda planes, widths: len(planes))
def blur_planes(begin, end, planes, widths):
    """`blur` of planes (n, h, w), each with its row of `widths` (n, k), in place."""
    for plane in range(begin, end):
        blur(planes[plane], widths[plane])
