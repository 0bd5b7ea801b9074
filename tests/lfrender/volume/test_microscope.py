"""From the figures of owners to pixels."""

from __future__ import annotations

import numpy as np
import pytest

from lfrender.volume.microscope import Microscope

WATER = {"na": 1.2, "magnification": 60, "medium_index": 1.35}


def test_a_focal_length_and_a_pixel_size_give_the_radius_of_the_pupil():
    scale = Microscope(**WATER, microlens_focal_length=2500, pixel_size=6.5).scale(
        radius=6.6, pitch=15.4
    )

    assert scale.pupil_radius == pytest.approx(2500 * 1.2 / 60 / 6.5)
    assert scale.flat_radius == pytest.approx(2500 * 1.35 / 60 / 6.5)
    assert scale.pixel == pytest.approx(6.5 / 60)


def test_without_a_pixel_size_it_follows_from_the_measured_radius():
    radius = 2500 * 1.2 / 60 / 6.5
    both = Microscope(**WATER, microlens_focal_length=2500, pixel_size=6.5).scale(radius, 15.4)
    one = Microscope(**WATER, microlens_focal_length=2500).scale(radius, 15.4)
    other = Microscope(**WATER, pixel_size=6.5).scale(radius, 15.4)

    for scale in (one, other):
        assert scale.pixel == pytest.approx(both.pixel)
        assert scale.slope_per_depth == pytest.approx(both.slope_per_depth)


def test_a_ray_at_the_rim_moves_by_the_tangent_of_its_angle():
    scale = Microscope(**WATER, microlens_focal_length=2500, pixel_size=6.5).scale(7.69, 15.4)
    depth = 10.0
    sine = 1.2 / 1.35
    moved = (
        scale.slope_per_depth
        * depth
        * sine
        * scale.flat_radius
        / np.sqrt(1 - sine**2)
        * scale.pixel
    )

    assert moved == pytest.approx(depth * np.tan(np.arcsin(sine)))


def test_missing_figures_are_named():
    assert Microscope(na=0.5).missing() == "magnification, pixel_size or microlens_focal_length"
    assert not Microscope(na=0.5).metric
    assert Microscope(**WATER, pixel_size=6.5).missing() == ""


@pytest.mark.parametrize(
    "figures", [{"na": -1}, {"na": 1.4}, {"magnification": 0}, {"wavelength": float("nan")}]
)
def test_impossible_figures_are_refused_by_name(figures):
    with pytest.raises(ValueError, match=next(iter(figures))):
        Microscope(**figures)
