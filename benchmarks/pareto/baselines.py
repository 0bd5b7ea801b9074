"""Textbook methods in calls of OpenCV and NumPy, for comparison with ours."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender
from lfcal.lattice.lattice import reduce_basis

__all__ = ["hough_lattice", "matched_patch_sizes", "tiled"]

_SHORTEST = 6.0
# Share of the strongest peak of a spectrum that a clear one has.
_CLEAR = 0.25
# Side of the template over the pitch.
_TEMPLATE = 0.35


def _grey(image: NDArray[Any]) -> NDArray[np.float32]:
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return (grey / np.float32(np.iinfo(image.dtype).max)).astype(np.float32)


def _spectral_basis(grey: NDArray[np.float32]) -> NDArray[np.float64]:
    """(2, 2) lattice basis [px] from the two lowest clear peaks of the amplitude spectrum that are
    not in one line.
    """
    height, width = grey.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    amplitude = np.abs(np.fft.rfft2((grey - grey.mean()) * window))
    fy, fx = np.meshgrid(np.fft.fftfreq(height), np.fft.rfftfreq(width), indexing="ij")
    amplitude[np.hypot(fx, fy) < 2 / min(height, width) * 2] = 0
    amplitude[np.hypot(fx, fy) > 1 / _SHORTEST] = 0
    waves: list[NDArray[np.float64]] = []
    # Overtones can be the strongest.
    peaks = (amplitude == cv2.dilate(amplitude, np.ones((3, 3)))) & (
        amplitude > _CLEAR * amplitude.max()
    )
    rows, columns = np.nonzero(peaks)
    for index in np.argsort(np.hypot(fx, fy)[rows, columns], kind="stable"):
        wave = np.array([fx[rows[index], columns[index]], fy[rows[index], columns[index]]])
        if not waves or abs(waves[0][0] * wave[1] - waves[0][1] * wave[0]) > 0.5 * (
            waves[0] @ waves[0]
        ):
            waves.append(wave)
        if len(waves) == 2:
            return np.linalg.inv(np.array(waves)).T
    raise ValueError("no two peaks")


def hough_lattice(image: NDArray[Any]) -> lfcal.Lattice:
    """Lattice through the centroids of circles: pitch from the spectrum, `cv2.HoughCircles`,
    moments, least squares.
    """
    grey = _grey(image)
    basis = _spectral_basis(grey)
    pitch = float(np.linalg.norm(basis, axis=1).min())
    bytes_ = cv2.normalize(grey, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)  # type: ignore[call-overload]
    circles = cv2.HoughCircles(
        bytes_,
        cv2.HOUGH_GRADIENT,
        1,
        0.8 * pitch,
        param1=100,
        param2=8,
        minRadius=int(0.35 * pitch),
        maxRadius=int(np.ceil(0.55 * pitch)),
    )
    if circles is None:
        raise ValueError("no circles")
    half = int(0.5 * pitch)
    centres = []
    for x, y, _ in np.asarray(circles).reshape(-1, 3):
        left = round(x) - half
        top = round(y) - half
        if left < 0 or top < 0:
            continue
        window = grey[top : top + 2 * half + 1, left : left + 2 * half + 1]
        moments = cv2.moments(np.where(window > 0.5 * window.max(), window, 0).astype(np.float32))
        if moments["m00"] > 0:
            centres.append(
                (left + moments["m10"] / moments["m00"], top + moments["m01"] / moments["m00"])
            )
    points = np.array(centres)
    start = points[np.argmin(np.linalg.norm(points - np.array(grey.shape[::-1]) / 2, axis=1))]
    # The spectrum knows the basis to a bin: fit it on growing surroundings.
    for reach in (3, 6, 12, 24, 48, np.inf):
        near = np.linalg.norm(points - start, axis=1) < reach * pitch
        index = np.rint((points[near] - start) @ np.linalg.inv(basis))
        design = np.column_stack([np.ones(len(index)), index])
        start, *rows = np.linalg.lstsq(design, points[near], rcond=None)[0]
        basis = np.array(rows)
    return lfcal.Lattice(start, reduce_basis(basis), (grey.shape[1], grey.shape[0]), pitch / 2)


def matched_patch_sizes(flat: NDArray[Any], lattice: lfcal.Lattice) -> NDArray[np.float64]:
    """(n,) signed patch size [px]: `cv2.matchTemplate` of the middle of each microimage in all its
    neighbours.
    """
    grey = _grey(flat)
    pitch = lattice.pitch
    half = max(2, round(0.5 * _TEMPLATE * pitch))
    reach = round(lattice.radius)
    centres, height, width = lattice.centres(), *grey.shape
    steps = lattice.steps @ lattice.basis
    sizes = np.full(len(centres), np.nan)
    for lens, centre in enumerate(centres):
        x, y = np.rint(centre).astype(int)
        if not (half <= x < width - half and half <= y < height - half):
            continue
        template = grey[y - half : y + half + 1, x - half : x + half + 1]
        found = []
        for step in steps:
            bx, by = np.rint(centre + step).astype(int)
            if not (reach <= bx < width - reach and reach <= by < height - reach):
                continue
            window = grey[by - reach : by + reach + 1, bx - reach : bx + reach + 1]
            score = cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED)
            *_, (u, v) = cv2.minMaxLoc(score)
            delta = (
                np.array([bx + u - reach + half, by + v - reach + half])
                - (centre + step)
                - ((x, y) - centre)
            )
            found.append(delta @ step / (step @ step) * pitch)
        if found:
            sizes[lens] = np.median(found)
    return sizes


def tiled(
    flat: NDArray[Any], lattice: lfcal.Lattice, patch_size: NDArray[Any], scale: float
) -> lfrender.Rendering:
    """Patches side by side: `cv2.remap` reads every pixel from the nearest lens."""
    width, height = lattice.image_size
    spacing = lattice.pitch / scale
    columns = round(width / spacing)
    rows = round(height / spacing)
    first = 0.5 * spacing - 0.5
    u, v = np.meshgrid(np.arange(columns), np.arange(rows))
    points = np.column_stack([u.ravel(), v.ravel()]) * spacing + first
    # OpenCV's nearest neighbours know no lattice.
    index = cv2.flann.Index(lattice.centres().astype(np.float32), {"algorithm": 1, "trees": 1})  # type: ignore[attr-defined]
    lens = index.knnSearch(points.astype(np.float32), 1, params={})[0][:, 0]
    centres = lattice.centres()[lens]
    s = np.nan_to_num(patch_size, nan=float(np.nanmedian(patch_size)))[lens]
    at = (centres - (points - centres) * (s / lattice.pitch)[:, None]).astype(np.float32)
    image = cv2.remap(
        flat, at[:, 0].reshape(rows, columns), at[:, 1].reshape(rows, columns), cv2.INTER_LINEAR
    )
    affine = np.array([[spacing, 0.0, first], [0.0, spacing, first]])
    return lfrender.Rendering(image, affine, np.ones((rows, columns), bool), scale)
