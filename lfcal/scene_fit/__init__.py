"""Lattice of scene captures: from a first lattice and the edges between microimages, for
`lfcal.lattice_search`.
"""
