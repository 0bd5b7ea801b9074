"""The mean over all lenses that agree on a place.

`lit_flat` prepares the flat, `occlusion` projects the surface into the microimages; `blend_rows` draws the usual
picture, `view_rows` one from a viewpoint aside, lens by lens along rows (`lens_runs`, `view_runs`), and `blend_pixels`
everything else.
"""
