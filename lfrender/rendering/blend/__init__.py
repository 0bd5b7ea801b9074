"""The mean over all lenses that agree on a place.

`lit_flat` prepares the flat, `occlusion` projects the surface into the microimages; `blend_rows`
draws the usual picture, each lens along rows, and `blend_pixels` everything else, by the same
formula.
"""
