"""What the evidence for a lattice says, in numbers and in words."""

from dataclasses import replace

import pytest


@pytest.fixture
def dark_discs(house_white_camera):
    """Evidence of dark round lenses in brighter gaps, with a board behind few of them."""
    return replace(
        house_white_camera.evidence,
        repeats=0.98,
        halves=0.005,
        fit_halves=None,
        roundness=0.95,
        shape=0.97,
        light=-0.7,
        content=-0.7,
        outline=0.5,
        borders=0.0,
        circles=0.9,
        circles_beside=0.0,
        fine=0.5,
        inverted=-0.3,
        overlap=0.0,
        parallax=0.02,
        still=0.04,
        continued=0.1,
        classes=0.0,
        inside=-2.6,
        detail=0.4,
        between=-4.5,
        unlike=0.0,
    )


def test_dark_discs_are_doubted_until_neighbours_match(dark_discs):
    assert 0.5 < dark_discs.probability < 0.8
    assert replace(dark_discs, parallax=0.6).probability > 0.9


def test_circles_of_another_place_prove_nothing(dark_discs):
    matching = replace(dark_discs, parallax=0.6, shape=0.5, roundness=0.3)
    assert matching.probability < 0.5


def test_circles_that_lie_between_the_points_as_well_prove_no_shape(house_white_camera):
    """The cell of an array, turned by 45 degrees and longer by the root of two."""
    white = replace(house_white_camera.evidence, circles=0.5)
    assert white.probability > 0.8
    assert replace(white, circles_beside=0.5).probability < 0.5


def test_cloth_and_tiles_are_no_lenses(house_white_camera):
    white = house_white_camera.evidence
    assert white.probability > 0.9
    # Circles lie on 0.12 of the points of cloth at most, or on those of a scene's tones.
    assert replace(white, fine=0.055, inverted=-0.91, circles=0.12).probability < 0.5
    assert replace(white, fine=0.04, inverted=-0.92, inside=-3.1).probability < 0.5
    tiles = replace(white, inside=-5.0, detail=0.5, between=-2.5, unlike=0.4, parallax=0.5)
    assert tiles.probability < 0.5


def test_circles_on_a_noisy_white_image_of_blurred_lenses_outweigh_its_lack_of_detail(
    house_white_camera,
):
    touching = replace(house_white_camera.evidence, fine=0.027, inverted=-0.88, circles=0.98)
    assert touching.probability > 0.9
    assert replace(touching, fine=0.008, inverted=-0.35).probability > 0.9
    assert replace(touching, circles=0.5).probability < 0.5


def test_the_words_name_the_proofs(house_white_camera):
    evidence = house_white_camera.evidence
    assert "shape of a lens, and circles lie on" in evidence.describe()
    touching = replace(
        evidence,
        shape=0.2,
        borders=0.9,
        parallax=0.8,
        inside=-3.0,
        between=-4.0,
        light=0.0,
        halves=0.01,
    )
    assert "cells touch each other on straight lines" in touching.describe()


def test_without_a_proof_the_words_are_those_of_the_doubt(house_white_camera):
    evidence = house_white_camera.evidence
    blank = replace(evidence, shape=0.2, circles=0.0, parallax=0.0)
    assert blank.describe() == blank.describe_doubt()


def test_noise_of_a_stated_white_image_hides_no_more_than_its_detail(house_white_camera):
    noisy = replace(house_white_camera.evidence, fine=0.036, inverted=-0.92, inside=-2.9)
    assert noisy.probability < 0.5
    assert replace(noisy, stated_white=1.0).probability > 0.9
    # Scenes and dots of print scatter light in some cells more than in others.
    assert replace(noisy, stated_white=1.0, detail=1.7).probability < 0.5
    assert replace(noisy, stated_white=1.0, circles=0.5).probability < 0.5
