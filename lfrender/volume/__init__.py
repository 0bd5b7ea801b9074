"""Volumes of light-field microscopes, by deconvolution of the raw flat on its own lattice
(experimental)."""

from .microscope import Microscope
from .volume import Volume

__all__ = ["Microscope", "Volume"]
