"""Figures of lattices: which of them tell white images from scenes."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lfcal.camera.lattice_figures import LatticeFigures, white_probability


@pytest.fixture
def figures():
    """Those of microimages with some scatter of light inside."""
    return LatticeFigures(
        repeats=0.9,
        halves=0.001,
        roundness=0.9,
        shape=0.95,
        light=1.0,
        content=0.0,
        outline=1.0,
        borders=0.0,
        circles=0.9,
        circles_beside=0.0,
        fine=0.2,
        inverted=-0.1,
        explained=0.5,
        inside=-2.0,
        detail=0.3,
    )


def test_evenly_lit_microimages_are_those_of_a_white_image():
    assert white_probability(-4.6, 0.2, 0.0) > 0.95
    assert white_probability(-1.5, 0.2, 0.0) < 0.05


@pytest.mark.parametrize("more", [(0.5, 0, 0), (0, 0.5, 0), (0, 0, 0.1)])
def test_scatter_detail_and_unlike_neighbours_speak_against_a_white_image(more):
    even = (-3.5, 0.3, 0.02)
    other = [value + step for value, step in zip(even, more, strict=True)]
    assert white_probability(*other) < white_probability(*even) - 0.05


def test_noise_of_a_stated_white_image_does_not_make_it_a_scene(figures):
    assert figures.white_probability < 0.5
    stated = replace(figures, stated_white=1.0)
    assert stated.white_probability > 0.9
    # Less scatter than that of white images without noise is no noise.
    even = replace(figures, inside=-5.5)
    assert replace(even, stated_white=1.0).white_probability == even.white_probability
    # Detail in some of the microimages is no noise either.
    assert replace(stated, detail=2.0).white_probability < 0.5
