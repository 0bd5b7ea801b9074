"""Flats of a microscope by scalar waves: each point of a specimen sends a wave through objective
and microlenses.

The wave in the image plane is the Fourier transform of the pupil with the phase of the depth of the
point; microlenses add a quadratic phase, and free space carries the wave to the sensor (angular
spectrum). Points shine incoherently, so that intensities add (Broxton et al. 2013, sections 3 and
4, without polarisation).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from .capture import MicroscopeCapture, photograph
from .microscope import Microscope
from .specimen import Specimen

__all__ = ["propagate_flat"]

# Samples of the wave per pixel: the phase of a microlens changes by less than half a turn between
# two.
_OVERSAMPLING = 2
# Directions of the aperture for the white image, along its diameter.
_DIRECTIONS = 25


class _Propagation:
    """The wave on a grid around the whole flat."""

    def __init__(self, microscope: Microscope) -> None:
        self.microscope = microscope
        width, height = microscope.size
        self.step = microscope.pixel / _OVERSAMPLING
        # Beyond the flat: waves that leave one border of the grid come in at the other.
        self.margin = round(2 * microscope.pitch)
        sides = [_OVERSAMPLING * (n + 2 * self.margin) for n in (height, width)]
        self.shape = tuple(fft.next_fast_len(n) for n in sides)
        # In pixels of the flat, each of which is the mean of its samples.
        self.y, self.x = (
            (np.arange(n) + 0.5) / _OVERSAMPLING - 0.5 - self.margin for n in self.shape
        )
        _, away = microscope.nearest_lenses(self.x, self.y)
        away2 = (away**2).sum(1).reshape(self.shape) * microscope.pixel**2
        wavelength = microscope.wavelength
        phase = -np.pi * away2 / (wavelength * microscope.microlens_focal_length)
        self.lenses = np.exp(1j * phase).astype(np.complex64)
        fy, fx = (fft.fftfreq(n, self.step).astype(np.float64) for n in self.shape)
        self.fx, self.fy = fx[None], fy[:, None]
        axial = np.sqrt(np.maximum(1 / wavelength**2 - self.fx**2 - self.fy**2, 0))
        to_sensor = 2 * np.pi * microscope.microlens_focal_length * axial
        self.to_sensor = np.exp(1j * to_sensor).astype(np.complex64)
        # Sines of the angles in the medium, by the sine condition.
        scale = wavelength * microscope.magnification / microscope.medium_index
        sine2 = (scale * self.fx) ** 2 + (scale * self.fy) ** 2
        self.cosine = np.sqrt(np.maximum(1 - sine2, 0))
        self.pupil = sine2 <= (microscope.na / microscope.medium_index) ** 2

    def intensity(self, point: NDArray[np.float64]) -> NDArray[np.float32]:
        """Light on the sensor's samples of one point x, y, z [um]."""
        microscope = self.microscope
        middle = (np.array(microscope.size) - 1) / 2 * microscope.pixel
        first = np.array([self.x[0], self.y[0]]) * microscope.pixel
        left, top = middle + point[:2] * microscope.magnification - first
        # Towards the objective, the point lies nearer to it than the native plane.
        depth = microscope.medium_index / microscope.wavelength * point[2] * self.cosine
        place = self.fx * left + self.fy * top
        wave = np.zeros(self.shape, np.complex64)
        phase = -2 * np.pi * (depth + place)
        wave[self.pupil] = (np.exp(1j * phase) / np.sqrt(np.maximum(self.cosine, 0.1)))[self.pupil]
        return self._on_sensor(fft.ifft2(wave, workers=1))

    def white(self) -> NDArray[np.float32]:
        """Light on the sensor's samples of an even, thick field: plane waves from everywhere in the
        aperture."""
        total = np.zeros(self.shape, np.float32)
        limit = self.microscope.na / self.microscope.magnification
        side = np.linspace(-limit, limit, _DIRECTIONS)
        across, down = np.meshgrid(self.x, self.y)
        for sx in side:
            for sy in side:
                if sx**2 + sy**2 <= limit**2:
                    way = (
                        (sx * across + sy * down)
                        * self.microscope.pixel
                        / self.microscope.wavelength
                    )
                    total += self._on_sensor(np.exp(2j * np.pi * way).astype(np.complex64))
        return total

    def _on_sensor(self, wave: NDArray[np.complex64]) -> NDArray[np.float32]:
        behind = fft.fft2(wave * self.lenses, workers=1)
        arrived = fft.ifft2(behind * self.to_sensor, workers=1)
        return (arrived.real**2 + arrived.imag**2).astype(np.float32)

    def pixels(self, samples: NDArray[np.float32]) -> NDArray[np.float64]:
        """(h, w) means over the samples of each pixel of the flat."""
        width, height = self.microscope.size
        first = _OVERSAMPLING * self.margin
        part = samples[
            first : first + _OVERSAMPLING * height, first : first + _OVERSAMPLING * width
        ]
        blocks = part.reshape(height, _OVERSAMPLING, width, _OVERSAMPLING)
        return blocks.mean((1, 3), dtype=np.float64)


def propagate_flat(
    specimen: Specimen,
    microscope: Microscope,
    *,
    spacing: float = 0.5,
    seed: int = 0,
    electrons: float | None = None,
    read: float = 2.0,
) -> MicroscopeCapture:
    """Photograph a small specimen by scalar waves: a point for each cube of `spacing` [um], a tenth
    of a second each.

    The rest is as for `trace_flat`.

    Examples
    --------
    >>> from data_synth.microscopy import Microscope, Specimen, propagate_flat
    >>> capture = propagate_flat(Specimen.beads([[0, 0, 2]], 0.2), Microscope(lenses=(5, 5)))
    >>> capture.flat.shape
    (77, 77)
    """
    rng = np.random.default_rng(seed)
    waves = _Propagation(microscope)
    total = np.zeros(waves.shape, np.float32)
    for point, light in zip(*specimen.points(spacing, rng), strict=True):
        total += np.float32(light) * waves.intensity(point)
    white = waves.pixels(waves.white())
    light = waves.pixels(total)
    return photograph(light, white, specimen, microscope, (electrons, read), rng)
