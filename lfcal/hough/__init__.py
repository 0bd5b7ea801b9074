"""Hough vote for circle centres: a check of the lattice that uses neither spectra nor averages."""
