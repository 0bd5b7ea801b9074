"""Refocusing in the Fourier domain (Ng 2005, section 4), to compare with the sum over lenses of `lfrender.refocus`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration
from lfrender.data.rendering import Rendering, convert_to_dtype
from lfrender.flat.gray_flat import correction_tables, trusted_radius
from lfrender.flat.lens_graph import lens_grid
from lfrender.flat.validation import check_flat

__all__ = ["refocus_fourier"]

# Where samples are this much sparser than usual, there is none.
_SPARSE = 0.1


def refocus_fourier(
    flat: NDArray, calibration: Calibration, patch_size: float, *, scale: float | None = None
) -> Rendering:
    """Draw the scene in focus at one depth as a slice through the spectrum of the light field.

    All lenses read at one place `q` of their microimages make a view, whose sample at the lens `c` is the scene point
    `c - q D / s`. The spectrum of the picture at a frequency is the sum over all views of their spectra there, each
    with the phase of its displacement: the slice of the 4D spectrum that belongs to this depth (Ng 2005, section 4).
    Views are aliased; the slice is taken beyond their Nyquist frequency, where their sum is not. It costs the more,
    the more pixels a microimage has: `refocus` is faster, reads between pixels, and takes all of a microimage.

    Parameters
    ----------
    flat : (H, W) or (H, W, C) array, uint8, uint16 or float
    calibration : Calibration
    patch_size : float [px]
        Signed patch size in focus.
    scale : float, optional
        Output pixels per pitch; by default `|patch_size|`.

    Raises
    ------
    FlatError, CalibrationError
        As `render`.
    ValueError
        If a number makes no picture.
    """
    pixels = check_flat(flat, calibration)
    lattice = calibration.lattice
    if not 0 < abs(patch_size) < lattice.pitch:
        raise ValueError(f"patch_size must lie between 0 and the pitch {lattice.pitch:.1f} px, got {patch_size}")
    scale = abs(patch_size) if scale is None else scale
    if not (np.isfinite(scale) and 0 < scale <= 4 * lattice.pitch):
        raise ValueError(f"scale must lie between 0 and four times the pitch ({4 * lattice.pitch:.0f}), got {scale}")
    fine = max(1, int(np.ceil(scale)))
    radius = trusted_radius(calibration)
    reach = np.arange(-int(radius), int(radius) + 1)
    offsets = np.stack(np.meshgrid(reach, reach), -1).reshape(-1, 2)
    offsets = offsets[np.hypot(*offsets.T) <= radius]
    # Displacements in lattice steps, and room for them so that nothing comes in from the opposite border.
    moved = -offsets * (lattice.pitch / patch_size) @ np.linalg.inv(lattice.basis)
    room = np.ceil(np.abs(moved).max(0)).astype(int) + 1
    grid, low = lens_grid(lattice)
    picture = _slice(pixels, calibration, np.pad(grid, [(room[1],) * 2, (room[0],) * 2], constant_values=-1), offsets,
                     moved, fine)  # fmt: skip
    spacing = lattice.pitch / scale
    width, height = lattice.image_size
    columns, rows = max(1, round(width / spacing)), max(1, round(height / spacing))
    first = 0.5 * spacing - 0.5
    v, u = np.mgrid[:rows, :columns]
    points = np.stack([u, v], -1).reshape(-1, 2) * spacing + first
    found = _between(picture, (lattice.to_index(points) - low + room) * fine).reshape(rows, columns, -1)
    valid = found[..., -1] > _SPARSE * np.median(found[..., -1])
    image = np.where(valid[..., None], found[..., :-1] / np.where(valid, found[..., -1], 1)[..., None], 0)
    if np.ndim(flat) == 2 and pixels.shape[2] == 1:
        image = image[:, :, 0]
    affine = np.array([[spacing, 0.0, first], [0.0, spacing, first]])
    return Rendering(
        convert_to_dtype(image.astype(np.float32), np.asarray(flat).dtype),
        affine,
        valid,
        float(scale),
        calibration.white_level,
    )


def _slice(
    pixels: NDArray,
    calibration: Calibration,
    grid: NDArray[np.int32],
    offsets: NDArray[np.int64],
    moved: NDArray[np.float64],
    fine: int,
) -> NDArray[np.float32]:
    """(rows, columns, C + 1) sums of samples on a lattice `fine` times as fine, and the sum of their weights."""
    from scipy.fft import fft2, fftfreq, ifft2

    centres = calibration.lattice.centres()
    (gains, *_), step = correction_tables(calibration)
    rows, columns = grid.shape
    known = grid >= 0
    down, across = fftfreq(rows * fine, 1 / rows / fine) / rows, fftfreq(columns * fine, 1 / columns / fine) / columns
    # A sample counts for the cell of the fine lattice that it lies in.
    cell = np.sinc(down / fine)[:, None] * np.sinc(across / fine)
    spectrum = np.zeros((rows * fine, columns * fine, pixels.shape[2] + 1), np.complex64)
    for offset, (x, y) in zip(offsets, moved, strict=True):
        gain = gains[min(int((offset @ offset) / step), len(gains) - 1)]
        places = centres + offset
        inside = ((places >= 0) & (places <= np.array(calibration.image_size) - 1)).all(1)
        values = np.zeros((len(centres), pixels.shape[2] + 1), np.float32)
        values[inside, :-1] = gain * _between(pixels, places[inside])
        values[inside, -1] = 1
        view = np.where(known[..., None], values[grid], 0)
        once = np.tile(fft2(view, axes=(0, 1)).astype(np.complex64), (fine, fine, 1))
        phase = np.exp(-2j * np.pi * y * down)[:, None] * np.exp(-2j * np.pi * x * across)
        spectrum += once * phase[..., None].astype(np.complex64)
    spectrum *= cell[..., None].astype(np.float32)
    return np.asarray(ifft2(spectrum, axes=(0, 1)).real, np.float32)


def _between(image: NDArray, places: NDArray[np.float64]) -> NDArray[np.float32]:
    """(n, C) values at places `x, y` (n, 2), linear between pixels."""
    height, width = image.shape[:2]
    corner = np.clip(np.floor(places).astype(int), 0, [width - 2, height - 2])
    part = (places - corner).astype(np.float32)
    x, y = corner.T
    fx, fy = part[:, :1], part[:, 1:]
    above = image[y, x] * (1 - fx) + image[y, x + 1] * fx
    below = image[y + 1, x] * (1 - fx) + image[y + 1, x + 1] * fx
    return np.asarray(above * (1 - fy) + below * fy, np.float32)
