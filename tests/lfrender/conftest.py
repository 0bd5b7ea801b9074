"""What the tests of the depth analysis share: flats drawn from a formula."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.flat.gray_flat import GrayFlat

SIZE = (420, 380)


@pytest.fixture(scope="session")
def drawn_flat():
    """Draws a flat of waves on a plane: the flat, its lattice, the true `s` of all lenses, which
    are off the border.
    """
    return _draw


def _nearest(lattice, points):
    """(n, 2) the centre nearest to each point."""
    index = np.rint(lattice.to_index(points))
    beside = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 2)
    centres = lattice.origin + (index[:, None] + beside) @ lattice.basis
    nearest = np.square(centres - points[:, None]).sum(2).argmin(1)
    return centres[np.arange(len(points)), nearest]


def _draw(
    patch_size, slant=(0.0, 0.0), noise=0.0, detail=1.3, basis=((23.2, 0.4), (11.25, 20.3)), seed=5
):
    """A flat drawn from waves in scene coordinates: exact at every pixel, with `s` and its slant at
    the middle lens.

    Waves reach `detail` radians per flat pixel. A plane has 1 / s linear in X (M is the virtual
    depth).
    """
    rng = np.random.default_rng(seed)
    lattice = Lattice((200.3, 180.7), basis, SIZE, 11.2)
    pitch = lattice.pitch
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    own = _nearest(lattice, points)
    middle = np.array(SIZE) / 2
    # s of a lens at c, and s(delta) = s(c) + g(c) . delta within it, with g = D * grad(1/s) * s.
    tilt = np.asarray(slant) / (pitch * patch_size)
    at = 1 / (1 / patch_size + (own - middle) @ tilt)
    delta = points - own
    s = at + pitch * at * (delta @ tilt)
    scene = own - delta * (pitch / s)[:, None]
    image = np.zeros(len(points))
    for _ in range(60):
        wave = rng.uniform(-1, 1, 2) * detail * abs(patch_size) / pitch
        image += np.cos(scene @ wave + rng.uniform(0, 2 * np.pi))
    image = 0.5 + 0.02 * image + noise * rng.standard_normal(len(points))
    centres = lattice.centres()
    truth = 1 / (1 / patch_size + (centres - middle) @ tilt)
    gray = GrayFlat(
        image.reshape(y.shape).astype(np.float32), centres.astype(np.float32), 10.2, pitch
    )
    inner = np.all((centres > 2 * pitch) & (centres < np.array(SIZE) - 2 * pitch), axis=1)
    return gray, lattice, truth, inner
