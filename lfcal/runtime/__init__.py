"""What both packages stand on: errors, output files, command lines, notebooks, Numba options and
small numerics.
"""
