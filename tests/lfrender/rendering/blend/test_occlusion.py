"""What microimage pixels see at depth edges: nearer points occlude farther ones."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.data.surface import Surface
from lfrender.rendering.blend.occlusion import project_surface

NEAR = 9.0
FAR = 5.0
EDGE = 199.0
REACH = 30.0


@pytest.fixture(scope="module")
def stepped():
    """A lattice, and a surface that is near right of `EDGE`."""
    lattice = Lattice((200.3, 180.7), ((23.2, 0.4), (11.25, 20.3)), (420, 380), 11.2)
    values = np.full((120, 132), FAR, np.float32)
    x = -0.5 + 3.25 * np.arange(132)
    values[:, x > EDGE] = NEAR
    return lattice, Surface(values, (-0.5, -0.5), 3.25)


def test_the_nearer_surface_is_seen_up_to_its_edge(stepped):
    lattice, surface = stepped
    seen, edged = project_surface(surface, lattice, REACH, 0.7)
    y, x = np.mgrid[:380, :420].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    own = lattice.origin + np.rint(lattice.to_index(points)) @ lattice.basis
    delta = points - own
    at = (own[:, 0] - delta[:, 0] * lattice.pitch / NEAR).reshape(x.shape)
    inside = (np.linalg.norm(delta, axis=1) < 9).reshape(x.shape)
    inside &= (
        (np.abs(at - own[:, 0].reshape(x.shape)) < REACH - 4)
        & (x > 40)
        & (x < 380)
        & (y > 40)
        & (y < 340)
    )
    of_edged = np.isin(own[:, 0].round(3), lattice.centres()[edged, 0].round(3)).reshape(x.shape)
    hidden = inside & of_edged & (at > EDGE + 7)
    open_ = inside & of_edged & (at < EDGE - 7)
    assert hidden.sum() > 1000 and (seen[hidden] == NEAR).mean() > 0.99
    assert open_.sum() > 1000 and np.isnan(seen[open_]).mean() > 0.99
