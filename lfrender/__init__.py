"""Depth analysis and rendering of focused plenoptic flats.

The public names, listed in `__init__.pyi`, are loaded at first use: `--help` needs none of them.
No module may have the name of a function here, or importing one would hide the other.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
