"""Kernels that Numba compiles: at their first call or ahead in several processes, cached by what they are made of."""
