"""Values that travel between depth analysis, rendering and files: depth maps, surfaces, pictures,
optics, viewpoints.

For every room above; plots for notebooks and napari are made from them here too. `house()`,
`clutter()`, `board()` and so on are sample data, `open_registry` those of a lab.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
