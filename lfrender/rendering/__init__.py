"""Pictures from a flat and its depth: all in focus, refocused, from other viewpoints, one pixel per
lens.

`renderer.Renderer` prepares what the kernels read and chooses between `fixed_patch` (one patch
size, nearest lens) and the kernels of `blend`; it also restores the detail (`lfrender.detail`).
"""
