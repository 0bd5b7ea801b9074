"""Files as layers of napari in scene coordinates: flats, camera files, depth maps."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from lfcal import FlatError, LightFieldError, load, read_flat
from lfcal.runtime.image_formats import IMAGE_SUFFIXES, RAW_SUFFIX

from .. import data
from ..data.depth_map import DepthMap
from ..data.plots import napari_layers
from ..output.formats import is_ome_name
from ..volume.files import read_volume
from ..volume.volume import layer_look

__all__ = ["clutter", "get_reader", "house"]

_CAMERAS = (".json", ".cfg")
Layer = tuple[Any, dict[str, Any], str]


def get_reader(path: str | list[str]) -> Callable[[str], list[Layer]] | None:
    """A function that reads the file as layers, None where lfrender does not read such files."""
    first = Path(path if isinstance(path, str) else path[0])
    suffix = first.suffix.lower()
    if suffix in (*_CAMERAS, ".npz"):
        # Other programs have such files too: those are left to them.
        try:
            _read(str(first))
        except (LightFieldError, RecursionError):
            return None
        return _read
    if suffix in {*IMAGE_SUFFIXES, RAW_SUFFIX, ".zarr"}:
        return _read
    return None


def _read(path: str | list[str]) -> list[Layer]:
    """Layers of one file, or of several."""
    layers: list[Layer] = []
    for one in [path] if isinstance(path, str) else path:
        suffix = Path(one).suffix.lower()
        if suffix == ".npz":
            layers += napari_layers(depth=DepthMap.load(one))
        elif suffix in _CAMERAS:
            layers += napari_layers(calibration=load(one))
        elif is_ome_name(Path(one)):
            layers += _read_ome(one)
        else:
            layers += napari_layers(flat=read_flat(one))
    return layers


def _read_ome(path: str) -> list[Layer]:
    """The layer of a volume or of a time lapse of volumes, or of a flat."""
    try:
        known = read_volume(path)
    except FlatError:
        return napari_layers(flat=read_flat(path))
    spacing = known["spacing"]
    origin = known["origin"]
    if known["data"].ndim == 4:
        spacing = [known["interval"] or 1.0, *spacing]
        origin = [0.0, *origin]
    return [(known["data"], layer_look(Path(path).name, spacing, origin), "image")]


def _sample(name: str) -> list[Layer]:
    """The flat of a sample, and its true camera."""
    sample = getattr(data, name)()
    return napari_layers(flat=sample.flat, calibration=sample.truth.calibration)


house = partial(_sample, "house")
clutter = partial(_sample, "clutter")
