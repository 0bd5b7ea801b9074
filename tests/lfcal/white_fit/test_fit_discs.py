"""Standard errors of a fit of two discs."""

from __future__ import annotations

import numpy as np

from lfcal.white_fit.fit_discs import _standard_errors


def test_parameters_that_the_pixels_do_not_tell_have_an_infinite_error():
    jacobian = np.random.default_rng(0).normal(size=(200, 5))
    jacobian[:, 2] = 0
    jacobian[:, 4] = 3 * jacobian[:, 3]
    errors = _standard_errors(jacobian)
    assert np.isinf(errors[2:]).all()
    np.testing.assert_allclose(errors[:2], 1 / np.sqrt(200), rtol=0.2)


def test_units_of_the_parameters_do_not_matter():
    jacobian = np.random.default_rng(1).normal(size=(50, 3))
    units = np.array([1e-9, 1.0, 1e9])
    np.testing.assert_allclose(
        _standard_errors(jacobian * units) * units, _standard_errors(jacobian)
    )
