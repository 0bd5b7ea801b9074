"""Proofs of lenses from the figures of a lattice, written down by hand."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from lfcal.camera import proofs
from lfcal.camera.lattice_figures import LatticeFigures

# Round lenses with dark gaps before a scene.
LENSES = LatticeFigures(
    repeats=0.98,
    halves=0.004,
    roundness=0.97,
    shape=0.99,
    light=1.5,
    content=2.5,
    outline=0.5,
    borders=0.0,
    circles=0.95,
    circles_beside=0.0,
    fine=0.3,
    inverted=-0.4,
    explained=1.0,
    parallax=1.5,
    still=0.1,
    inside=-2.0,
    detail=0.6,
    between=-3.8,
)
# Square lenses that touch each other.
TOUCHING = replace(
    LENSES, roundness=0.4, shape=0.5, outline=0.0, light=0.0, content=0.0, circles=0.0, borders=0.95
)


def test_round_lenses_of_a_scene_are_proven_in_three_ways():
    assert proofs.proof_by_shape(LENSES) == pytest.approx(1)
    assert proofs.proof_by_content(LENSES) > 0.8
    assert proofs.proof_by_circles(LENSES) > 0.8
    terms = proofs.proof_terms(LENSES)
    assert terms["proof"] == pytest.approx(1)
    assert terms["both_proofs"] == pytest.approx(1)
    assert terms["sound"] == pytest.approx(1)
    assert terms["unmatched"] == 0


def test_lenses_that_touch_are_proven_by_borders_alone():
    assert proofs.proof_by_borders(TOUCHING) == pytest.approx(1)
    assert proofs.proof_by_shape(TOUCHING) == 0
    assert proofs.proof_by_circles(TOUCHING) == 0
    assert proofs.proof_terms(TOUCHING)["proof"] == pytest.approx(1)


@pytest.mark.parametrize(
    ("figures", "changed"),
    [
        (LENSES, {"fine": 0.0, "circles": 0.0}),
        (LENSES, {"inverted": -0.98}),
        (LENSES, {"repeated": 0.995}),
        (TOUCHING, {"repeated": 0.995}),
        (replace(TOUCHING, parallax=0.5), {"classes": 0.35}),
        (replace(LENSES, shape=0.5), {"borders_beside": 0.9}),
        (TOUCHING, {"parallax": 0.1}),
        (TOUCHING, {"halves": 0.1}),
        (TOUCHING, {"inside": -5.0, "detail": 0.0}),
    ],
    ids=[
        "waves",
        "board",
        "two cells",
        "two touching cells",
        "half a cell",
        "borders elsewhere",
        "tiles",
        "two lattices",
        "no content",
    ],
)
def test_other_patterns_are_not_proven(figures, changed):
    assert proofs.proof_terms(figures)["proof"] > 0.9
    assert proofs.proof_terms(replace(figures, **changed))["proof"] < 0.1


def test_content_that_repeats_without_parallax_is_not_the_array():
    print_ = replace(TOUCHING, still=1.5, repeats=0.6, borders=0.0)
    assert proofs.is_everywhere(LENSES) == pytest.approx(1)
    assert proofs.is_everywhere(print_) == pytest.approx(0)


@pytest.mark.parametrize(
    ("irregularity", "everywhere"), [(0.0, 1.0), (0.008, 1.0), (0.03, 0.0), (0.12, 1.0)]
)
def test_content_that_stretches_a_regular_array_is_not_the_array(irregularity, everywhere):
    stretched = replace(TOUCHING, borders=0.0, irregularity=irregularity)
    assert proofs.is_everywhere(stretched) == pytest.approx(everywhere)
    assert proofs.is_everywhere(replace(LENSES, irregularity=irregularity)) == pytest.approx(1)


def test_one_picture_behind_a_mesh_is_an_objection():
    mesh = replace(TOUCHING, parallax=0.0, still=0.0, continued=0.6)
    assert proofs.is_mesh(mesh) == pytest.approx(1)
    assert proofs.is_mesh(LENSES) == 0
    assert proofs.proof_terms(mesh)["sound"] == pytest.approx(0)


def test_terms_of_any_figures_are_shares():
    rng = np.random.default_rng(0)
    names = [field.name for field in fields(LatticeFigures) if field.name != "fit_halves"]
    for stated in range(500):
        figures = LatticeFigures(**{name: float(rng.uniform(-5, 3)) for name in names})
        figures = replace(figures, stated_white=float(stated % 2))
        for name, term in proofs.proof_terms(figures).items():
            assert 0 <= term <= 1, name
