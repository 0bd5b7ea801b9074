"""Flats as arrays: reading image files whole or in parts, and preparing pixels for the search of
the lattice.
"""
