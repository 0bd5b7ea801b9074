"""Kernels compiled ahead of their first call, and checksums of what was compiled."""
