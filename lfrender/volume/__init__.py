"""Volumes of light-field microscopes, by deconvolution of the raw flat (experimental)."""

from .microscope import Microscope
from .volume import Volume

__all__ = ["Microscope", "Volume"]
