"""Depth edges placed on the pixels: each pixel of the microimages around an edge gets a depth, and
these vote.

From a depth map with its dense surface and the grey flat; the last stage of the preset
`"balanced"`.
"""
