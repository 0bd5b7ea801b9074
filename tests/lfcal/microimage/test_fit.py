"""Fit of a lattice and of a parameter that all lenses share, on equations that are exact."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from lfcal.lattice.lattice import Lattice
from lfcal.microimage.fit import Sums, converge, select_orders
from lfcal.runtime.errors import CalibrationError

_TRUE = Lattice((7.3, 8.1), [[20.0, 0.4], [-0.4, 20.0]], (600, 400), 9.0)


@dataclass(frozen=True)
class _Dots:
    """Lenses whose places are measured directly, one of them beside a shared shift in x."""

    indices: np.ndarray
    places: np.ndarray
    centres: np.ndarray
    shared: float = 0.0

    @property
    def parameters(self):
        return np.array([self.shared])

    @property
    def prior(self):
        # A shift of all lenses is that of the origin: only the prior tells them apart.
        return np.array([1e6]), np.array([1e6 * (0.5 - self.shared)])

    def sums(self):
        columns = np.zeros((len(self.places), 2, 4))
        columns[:, :, :2] = np.eye(2)
        columns[:, 0, 2] = 1
        miss = self.places - self.centres - np.array([self.shared, 0])
        normal = 100 * np.einsum("nap,naq->npq", columns, columns)
        normal[:, 3, 3] = 1
        return Sums(normal, 100 * np.einsum("nap,na->np", columns, miss), np.zeros((0, 0, 6)))

    def learn(self, sums, step, lattice):
        shared = self.shared + float(step.of_light[0])
        return replace(self, centres=lattice.points(self.indices), shared=shared)


def _dots(lattice, noise=0.01, start=_TRUE):
    indices = start.indices()
    rng = np.random.default_rng(0)
    places = lattice.points(indices) + noise * rng.standard_normal((len(indices), 2))
    return _Dots(indices, places + np.array([0.5, 0]), start.points(indices))


def test_lattice_and_shared_parameter_are_found_and_outliers_left_out():
    start = replace(_TRUE, origin=_TRUE.origin + 0.3, basis=1.002 * _TRUE.basis)
    dots = _dots(_TRUE, start=start)
    dots.places[::9] += 3.0
    fit = converge(start, dots, ())
    np.testing.assert_allclose(fit.lattice.origin, _TRUE.origin, atol=0.005)
    np.testing.assert_allclose(fit.lattice.basis, _TRUE.basis, atol=0.001)
    assert fit.lenses.shared == pytest.approx(0.5, abs=0.001)
    assert (fit.step.weight[::9] == 0).all()
    assert fit.step.residual_rms == pytest.approx(0.01 * np.sqrt(2) / 0.86, rel=0.15)
    assert fit.step.half_difference() < 6 * fit.step.uncertainty


def test_only_a_distortion_that_is_there_is_selected():
    bent = replace(_TRUE, distortion=None)
    assert select_orders(converge(bent, _dots(bent), ())).orders == ()
    from lfcal.lattice.distortion import Distortion

    true = replace(_TRUE, distortion=replace(Distortion.zero(_TRUE.image_size), k1=0.002))
    fit = select_orders(converge(bent, _dots(true), ()))
    assert fit.orders == ("k1",)
    assert fit.lattice.distortion.k1 == pytest.approx(0.002, abs=1e-4)


def test_lenses_on_no_lattice_raise_a_calibration_error():
    dots = _dots(replace(_TRUE, basis=1.1 * _TRUE.basis))
    with pytest.raises(CalibrationError, match="keep to one lattice"):
        converge(_TRUE, dots, ())
