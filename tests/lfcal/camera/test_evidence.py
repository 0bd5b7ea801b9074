"""What the evidence for a lattice says in words."""

from dataclasses import replace


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
