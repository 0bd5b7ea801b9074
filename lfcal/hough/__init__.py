"""Hough vote for circle centres: a witness of the lattice that uses neither spectra nor averages."""
