"""Values that depth analysis, rendering and files exchange: depth maps, pictures, ...

For every room above; plots for notebooks and napari are made from them here too. `house()`,
`clutter()`, `board()` and so on are sample data, `open_registry` those of a lab.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..depth.example import example
    from .registry import Registry, open_registry, write_registry
    from .samples import board, cache_folder, clutter, house, periodic, plane, ramp, slope

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

# Modules of the names; samples have all others.
_HOMES = {
    "Registry": ".registry",
    "example": "..depth.example",
    "open_registry": ".registry",
    "write_registry": ".registry",
}


def __getattr__(name: str) -> Any:
    # At first use, as in `lfrender`: the rooms above import this one for its modules.
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES.get(name, ".samples"), __name__), name)
