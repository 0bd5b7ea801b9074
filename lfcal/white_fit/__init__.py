"""Lattice of a white image, by a model of every pixel: discs of one profile, cut by a second disc
where it vignettes.

From a first lattice (`detection`) and the light of a flat, for `lfcal.lattice_fit`. Of flats in
parts, `large` finds the first lattice itself.
"""
