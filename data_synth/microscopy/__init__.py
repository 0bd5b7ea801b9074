"""Simulated light-field microscopes: beads and shells with known truth, by rays or by scalar waves.

>>> from data_synth.microscopy import Microscope, Specimen, trace_flat
>>> microscope = Microscope(lenses=(9, 9))
>>> capture = trace_flat(Specimen.shell(radius=4.0, thickness=1.0), microscope, samples=4)
>>> capture.flat.shape, capture.calibration.lattice.pitch
((139, 139), 15.4)
"""

from .capture import MicroscopeCapture
from .microscope import Microscope
from .rays import trace_flat
from .specimen import Specimen
from .waves import propagate_flat

__all__ = ["Microscope", "MicroscopeCapture", "Specimen", "propagate_flat", "trace_flat"]
