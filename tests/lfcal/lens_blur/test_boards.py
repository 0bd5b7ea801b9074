"""Aperture and focus of lens types from edges at known depths."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.lens_blur.boards import Edges, _tabulate_widths, fit_discs

FOCI = np.array([-0.4, -0.25])
APERTURE = 6.0


def edges(ratios, spread=0.005):
    """Edges of two lens types that are also blurred by 0.3 px at all depths."""
    kinds = np.repeat([0, 1], len(ratios))
    both = np.tile(ratios, 2)
    discs = np.hypot(APERTURE * (both - FOCI[kinds]), 0.3)
    widths = np.interp(discs, *_tabulate_widths())
    return Edges(kinds, both, widths, np.full(len(both), spread))


def test_aperture_and_foci_of_two_types_are_found_on_both_sides_of_focus():
    found = fit_discs(edges(np.linspace(-0.5, -0.15, 6)), 2, 28.0, None)
    assert found.aperture == pytest.approx(APERTURE, abs=0.15)
    assert found.focus == pytest.approx(FOCI, abs=0.005)
    assert found.tells_aperture


def test_widths_that_scatter_within_a_pose_leave_wide_errors():
    sure = fit_discs(edges(np.linspace(-0.5, -0.15, 6)), 2, 28.0, None)
    mixed = fit_discs(edges(np.linspace(-0.5, -0.15, 6), spread=0.15), 2, 28.0, None)
    assert mixed.aperture_error > 2 * sure.aperture_error


def test_too_few_poses_tell_nothing():
    assert fit_discs(edges(np.array([-0.3])), 2, 28.0, None) is None
