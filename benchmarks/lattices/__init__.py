"""Does calibration find the right lattice on any flat? Random cameras, pictures that are no flats,
other forms.
"""
