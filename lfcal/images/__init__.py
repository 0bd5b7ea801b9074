"""Flats as arrays: image files read whole or in parts, pixels prepared for the lattice search."""
