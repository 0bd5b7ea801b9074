"""Images and statistics of one flat: colour, brightness corrected for vignetting, texture, noise,
blur; its lens graph.

Computed from a flat and its calibration, for `depth` and `rendering`.
"""
