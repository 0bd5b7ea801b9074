"""Kernels that Numba compiles: when they are first called, or ahead in several processes."""
