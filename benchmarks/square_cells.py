"""Centres of white images of square cells: `python -m benchmarks.square_cells FIRST LAST`.

Each seed draws one white image of square cells whose straight edges a Gaussian blurs. The light is
exact: the product of that across and down, each integrated over the pixel. A last column names
errors over 0.002 px. The formulas share nothing with `lfcal`.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

import lfcal

__all__ = ["SquareCells", "draw_cells", "main"]

_SIZE = (900, 700)
_MOST_ERROR = 0.002


@dataclass(frozen=True)
class SquareCells:
    """White image of a square lattice, in px; light is 1 in a cell in the middle of the flat."""

    pitch: float
    gap: float
    blur: float  # standard deviation of the Gaussian
    noise: float
    shading: float  # loss of light in the corners
    stray: float
    origin: tuple[float, float]
    seed: int

    def image(self) -> NDArray[np.uint8]:
        """(700, 900) pixels of 8 bits."""
        across, down = (
            self._line(length, start) for length, start in zip(_SIZE, self.origin, strict=True)
        )
        light = self.stray + (1 - self.stray) * down[:, None] * across
        y, x = np.mgrid[: _SIZE[1], : _SIZE[0]]
        middle = (np.array(_SIZE) - 1) / 2
        far = ((x - middle[0]) ** 2 + (y - middle[1]) ** 2) / (middle**2).sum()
        light *= 1 - self.shading * far
        light += self.noise * np.random.default_rng(self.seed).standard_normal(light.shape)
        return np.rint(np.clip(200 * light, 0, 255)).astype(np.uint8)

    def _line(self, length: int, start: float) -> NDArray[np.float64]:
        """(length,) light of pixels along one side."""
        half = (self.pitch - self.gap) / 2
        number = int(length / self.pitch) + 4
        middles = start + self.pitch * np.arange(-number, number + 1)[:, None]
        ends = np.arange(length + 1) - 0.5
        rise = self._integral(ends - middles + half)
        fall = self._integral(ends - middles - half)
        return np.asarray(np.diff(rise - fall, axis=1).sum(0))

    def _integral(self, depth: NDArray[np.float64]) -> NDArray[np.float64]:
        """Integral of the light inside a blurred edge, up to a depth [px]."""
        far = depth / self.blur
        height = np.exp(-0.5 * far**2) / np.sqrt(2 * np.pi)
        return np.asarray(depth * ndtr(far) + self.blur * height)

    def error(self, lattice: lfcal.Lattice) -> float:
        """RMS distance [px] of the centres inside the flat from the true ones."""
        number = np.arange(-int(_SIZE[0] / self.pitch), int(_SIZE[0] / self.pitch) + 1)
        index = np.stack(np.meshgrid(number, number), -1).reshape(-1, 2)
        centres = np.array(self.origin) + self.pitch * index
        centres = centres[((centres > 0) & (centres < np.array(_SIZE) - 1)).all(1)]
        near = lattice.points(np.rint(lattice.to_index(centres)))
        return float(np.sqrt(((near - centres) ** 2).sum(1).mean()))


def draw_cells(seed: int) -> SquareCells:
    """Random square cells; half of the pitches are whole numbers."""
    rng = np.random.default_rng(seed)
    pitch = float(rng.uniform(35, 75))
    if seed % 2:
        pitch = float(round(pitch))
    x, y = (np.array(_SIZE) / 2 + rng.uniform(0, pitch, 2)).tolist()
    return SquareCells(
        pitch,
        gap=float(rng.choice([1, 2, 3])),
        blur=float(rng.uniform(0.3, 0.8)),
        noise=float(rng.choice([0.003, 0.01, 0.02])),
        shading=float(rng.uniform(0, 0.3)),
        stray=float(rng.uniform(0, 0.03)),
        origin=(x, y),
        seed=seed,
    )


def main(arguments: list[str]) -> None:
    """Print a table of the seeds from the first argument to the second one, included."""
    first, last = map(int, arguments)
    beyond = 0
    print(f"{'seed':>5s} {'pitch':>7s} {'gap':>4s} {'blur':>5s} {'noise':>6s} {'error px':>9s}")
    for seed in range(first, last + 1):
        cells = draw_cells(seed)
        error = cells.error(lfcal.calibrate(cells.image(), kind="white").lattice)
        beyond += error > _MOST_ERROR
        row = f"{seed:5d} {cells.pitch:7.3f} {cells.gap:4.0f} {cells.blur:5.2f} {cells.noise:6.3f}"
        print(f"{row} {error:9.5f}{'  beyond' * (error > _MOST_ERROR)}", flush=True)
    print(f"{beyond} of {last - first + 1} beyond {_MOST_ERROR} px")


if __name__ == "__main__":
    main(sys.argv[1:])
