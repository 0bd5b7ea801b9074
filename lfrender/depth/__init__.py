"""Estimates the signed patch size of every lens of a flat, and from these a dense surface, for
rendering.

`analyze` is the public function, `pipeline` the order of the passes; each pass has a sub-package.
"""
