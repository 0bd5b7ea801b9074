"""A simulated capture and its volume, made once."""

from __future__ import annotations

import pytest

import lfrender
from data_synth.microscopy import Microscope, Specimen, trace_flat


@pytest.fixture(scope="session")
def shells():
    """Two shells and a bead, ray-traced, with photon noise."""
    microscope = Microscope(lenses=(17, 17), rotation=2.0)
    specimen = Specimen.shell(6.0, 1.4, (0.5, -0.3, 0.8)) + Specimen.beads([[-8.0, 8.0, 4.0]], 0.8)
    specimen += Specimen.shell(3.0, 1.2, (7.5, 7.0, -3.5))
    return trace_flat(specimen, microscope, samples=32, seed=5, electrons=3000)


@pytest.fixture(scope="session")
def shell_volume(shells):
    optics = lfrender.Microscope(**shells.microscope.optics())
    return lfrender.reconstruct_volume(
        shells.flat, shells.calibration, optics, depth_range=(-9, 9), planes=25
    )
