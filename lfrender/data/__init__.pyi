from .registry import Registry, open_registry, write_registry
from .samples import board, cache_folder, clutter, example, house, periodic, plane, ramp, slope

__all__ = [
    "Registry",
    "board",
    "cache_folder",
    "clutter",
    "example",
    "house",
    "open_registry",
    "periodic",
    "plane",
    "ramp",
    "slope",
    "write_registry",
]
