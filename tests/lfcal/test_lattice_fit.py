"""The final fit is kept only where it stays with the first lattice."""

from __future__ import annotations

from dataclasses import replace

import lfcal


def test_fit_that_leaves_the_first_lattice_is_discarded(whites, monkeypatch):
    from lfcal.white_fit import fit as white_fit

    true_fit = white_fit.fit_white

    def astray(light, lattice):
        found = true_fit(light, lattice)
        return replace(found, lattice=replace(found.lattice, basis=found.lattice.basis * 1.03))

    monkeypatch.setattr(white_fit, "fit_white", astray)
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, (500, 400))
    assert whites.rms(whites.centre_errors(lfcal.calibrate(image).lattice, origin, basis)) < 0.1
