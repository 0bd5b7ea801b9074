"""The microlens lattice: centres and cells of the microimages, distortion, residuals, standard
errors, subsets.
"""
