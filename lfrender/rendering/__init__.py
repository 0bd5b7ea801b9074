"""Pictures from a flat and its depth: all in focus, refocused, from other viewpoints, one pixel per
lens.

`renderer.Renderer` prepares what the kernels of `blend` read and chooses between them; it also
restores the detail (`lfrender.detail`).
"""
