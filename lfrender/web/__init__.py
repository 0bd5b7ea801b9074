"""Pages for the browser, from a flat, its calibration and its depth: the report, the viewer, and
the demo.
"""
