"""Lattice of a white image from a model of every pixel.

Microimages are discs of one profile; where the main lens vignettes, a second disc cuts them.

From a first lattice (`detection`) and the light of a flat, for `lfcal.lattice_search`. Of flats in
parts, `large` finds the first lattice itself.
"""
