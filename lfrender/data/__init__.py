"""Values that travel between depth analysis, rendering and files: depth maps, surfaces, pictures, optics, viewpoints.

For every room above; plots for notebooks and napari are made from them here too.
"""
