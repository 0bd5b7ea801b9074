"""Pixels of video: frames of PyAV as arrays, and the layout of raw planar files, which have no header."""
