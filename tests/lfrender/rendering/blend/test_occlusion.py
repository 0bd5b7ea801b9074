"""What microimage pixels see at depth edges: nearer points occlude farther ones."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.data.surface import Surface
from lfrender.rendering.blend.occlusion import project_surface

NEAR, FAR, EDGE, REACH = 9.0, 5.0, 199.0, 30.0


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
    seen = project_surface(surface, lattice, REACH, 0.7)
    y, x = np.mgrid[:380, :420].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    own = lattice.origin + np.rint(lattice.to_index(points)) @ lattice.basis
    delta = points - own
    at = (own[:, 0] - delta[:, 0] * lattice.pitch / NEAR).reshape(x.shape)
    inside = (np.linalg.norm(delta, axis=1) < 9).reshape(x.shape)
    inside &= (np.abs(at - own[:, 0].reshape(x.shape)) < REACH - 4) & (x > 40) & (x < 380) & (y > 40) & (y < 340)
    edged = np.zeros(len(lattice), bool)
    project_surface(surface, lattice, REACH, 0.7, edged=edged)
    of_edged = np.isin(own[:, 0].round(3), lattice.centres()[edged, 0].round(3)).reshape(x.shape)
    hidden, open_ = inside & of_edged & (at > EDGE + 7), inside & of_edged & (at < EDGE - 7)
    assert hidden.sum() > 1000 and (seen[hidden] == NEAR).mean() > 0.99
    assert open_.sum() > 1000 and np.isnan(seen[open_]).mean() > 0.99


def test_only_lenses_within_reach_of_a_step_are_edged(stepped):
    lattice, surface = stepped
    edged = np.zeros(len(lattice), bool)
    project_surface(surface, lattice, REACH, 0.7, edged=edged)
    away = np.abs(lattice.centres()[:, 0] - EDGE)
    assert edged[away < REACH - 3.25].all()
    assert not edged[away > REACH + 3.25].any()
    project_surface(surface, lattice, REACH, NEAR - FAR + 0.1, edged=edged)
    assert not edged.any()


def test_an_incremental_update_equals_a_new_projection(stepped):
    lattice, surface = stepped
    moved = surface.patch_size.copy()
    moved[30:60, 40:75] = NEAR
    surfaces = [surface, Surface(moved, surface.first, surface.spacing), surface]
    edged = np.zeros((2, len(lattice)), bool)

    def projected(surface, lattice=lattice, part=None, incremental=True):
        return project_surface(surface, lattice, REACH, 0.7, part, edged[0], "test", incremental)

    projected(surfaces[0], incremental=False)
    before = edged[0].copy()
    for number, after in enumerate(surfaces[1:]):
        seen = projected(after)
        assert np.array_equal(seen, project_surface(after, lattice, REACH, 0.7, edged=edged[1]), equal_nan=True)
        assert np.array_equal(edged[0], edged[1])
        assert (number == 1) == np.array_equal(edged[0], before)
    # Only lenses that may differ are projected anew; other memory is left untouched.
    far = np.flatnonzero(np.linalg.norm(lattice.centres() - [380, 330], axis=1) < 15)[0]
    x, y = lattice.centres()[far].round().astype(int)
    projected(surfaces[0])[y, x] = 123.0
    assert projected(surfaces[1])[y, x] == 123.0 and projected(surfaces[1], incremental=False)[y, x] != 123.0
    # The projection of another lattice or part is not updated.
    projected(surfaces[1], part=(100, 50, 420, 380))
    turned = Lattice(lattice.origin, np.asarray(lattice.basis)[::-1], lattice.image_size, lattice.radius)
    projected(surfaces[1], turned)
    assert np.array_equal(projected(surface), project_surface(surface, lattice, REACH, 0.7), equal_nan=True)
