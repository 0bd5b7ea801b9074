"""Pictures from a flat and its depth: all in focus, refocused, from other viewpoints, one pixel per lens.

`plan.RenderPlan` prepares what the kernels read and chooses one of three: `fixed_patch` (one patch size, nearest lens),
`blend_rows` (the usual blended picture) or `blend_pixels` (everything else).
"""
