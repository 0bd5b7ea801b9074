"""Volumes as files of the microscopy community: OME-TIFF and OME-Zarr (NGFF 0.5)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal import FlatError
from lfcal.runtime.output_file import atomic_write, check_output

from ..output.formats import FORMATS, check_format_package, write_ome_zarr
from ..runtime.types import AnyPath

if TYPE_CHECKING:
    from .volume import Volume

__all__ = ["SUFFIXES", "check_volume_file", "read_volume", "write_volume"]

#: Endings of files of volumes.
SUFFIXES = (".tif", ".tiff", ".zarr")
# What files hold beside the voxels.
_FIELDS = ("spacing", "origin", "unit", "slopes", "pitch", "fit", "warnings")


def check_volume_file(path: AnyPath) -> None:
    """Raise OutputError or PictureError if a volume could not be written."""
    check_output(path, SUFFIXES)
    check_format_package(path, FORMATS[Path(path).suffix.lower()])


def write_volume(path: AnyPath, volume: Volume) -> None:
    """Write a volume as the ending of the name asks; whole or not at all."""
    target = Path(path)
    check_volume_file(target)
    if target.suffix.lower() == ".zarr":
        unit = "micrometer" if volume.unit == "um" else None
        place = (list(volume.spacing), list(volume.origin))
        write_ome_zarr(target, volume.data, "zyx", *place, _describe(volume), unit)
    else:
        _write_tiff(target, volume)


def read_volume(path: AnyPath) -> dict[str, Any]:
    """Voxels (`data`) and other fields of a file of `write_volume`; else a FlatError."""
    target = Path(path)
    try:
        if target.suffix.lower() == ".zarr":
            import zarr

            group: Any = zarr.open_group(str(target), mode="r")
            data = group["0"][:]
            text = group.attrs["description"]
        else:
            import tifffile

            with tifffile.TiffFile(target) as tiff:
                about = tifffile.xml2dict(tiff.ome_metadata or "<OME/>")
                text = about["OME"]["Image"]["Description"]
                data = tiff.asarray()
        known = json.loads(text)
        return {"data": data} | {name: known[name] for name in _FIELDS}
    # Readers raise errors of many kinds on other files.
    except Exception as error:
        raise FlatError(
            f"{target}: is no volume that 'lfrender volume' has written ({error})"
        ) from error


def _describe(volume: Volume) -> str:
    """The JSON text of a volume."""
    about = {
        "software": "lfrender",
        "unit": volume.unit,
        "spacing": volume.spacing,
        "origin": volume.origin,
        "slopes": volume.slopes.tolist(),
        "pitch": volume.pitch,
        "fit": vars(volume.fit),
        "warnings": volume.warnings,
    }
    return json.dumps(about)


def _write_tiff(path: Path, volume: Volume) -> None:
    import tifffile

    metric = volume.unit == "um"
    about: dict[str, Any] = {"axes": "ZYX", "Description": _describe(volume)}
    for axis, size in zip("ZYX", volume.spacing, strict=True):
        about[f"PhysicalSize{axis}"] = size
        about[f"PhysicalSize{axis}Unit"] = "µm" if metric else "pixel"
    if not metric:
        about["PhysicalSizeZUnit"] = "reference frame"
    with atomic_write(path) as temporary:
        tifffile.imwrite(
            temporary,
            volume.data,
            ome=True,
            photometric="minisblack",
            software="lfrender",
            metadata=about,
        )
