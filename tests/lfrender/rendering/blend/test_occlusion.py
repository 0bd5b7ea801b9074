"""What microimage pixels see at depth edges: nearer points occlude farther ones."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.data.surface import Surface
from lfrender.rendering.blend.occlusion import project_surface

EDGE = 199.0
REACH = 30.0


def step(near, far):
    """A lattice, and a surface that is `near` right of `EDGE`, else `far`."""
    lattice = Lattice((200.3, 180.7), ((23.2, 0.4), (11.25, 20.3)), (420, 380), 11.2)
    values = np.full((120, 132), far, np.float32)
    x = -0.5 + 3.25 * np.arange(132)
    values[:, x > EDGE] = near
    return lattice, Surface(values, (-0.5, -0.5), 3.25)


# Binocular lenses see near points from farther away than far ones: up to 64 px here.
@pytest.mark.parametrize("near, far", [(9.0, 5.0), (-4.0, -9.0)])
def test_the_nearer_surface_is_seen_up_to_its_edge(near, far):
    lattice, surface = step(near, far)
    seen, edged = project_surface(surface, lattice, REACH, 0.7)
    y, x = np.mgrid[:380, :420].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    own = lattice.origin + np.rint(lattice.to_index(points)) @ lattice.basis
    delta = points - own
    at = (own[:, 0] - delta[:, 0] * lattice.pitch / near).reshape(x.shape)
    behind = np.linalg.norm(delta, axis=1) * lattice.pitch / abs(far)
    inside = ((np.linalg.norm(delta, axis=1) < 9) & (behind < REACH - 4)).reshape(x.shape)
    inside &= (x > 40) & (x < 380) & (y > 40) & (y < 340)
    of_edged = np.isin(own[:, 0].round(3), lattice.centres()[edged, 0].round(3)).reshape(x.shape)
    hidden = inside & (at > EDGE + 7) & (np.abs(own[:, 0].reshape(x.shape) - EDGE) < REACH)
    open_ = inside & of_edged & (at < EDGE - 7)
    assert hidden.sum() > 1000 and (seen[hidden] == near).mean() > 0.99
    assert open_.sum() > 1000 and np.isnan(seen[open_]).mean() > 0.99
