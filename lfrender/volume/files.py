"""Volumes as files of the microscopy community: OME-TIFF and OME-Zarr (NGFF 0.5)."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lfcal import FlatError
from lfcal.runtime.arrays import Singles
from lfcal.runtime.output_file import atomic_write, check_output

from ..output.formats import FORMATS, check_format_package, write_ome_zarr
from ..runtime.types import AnyPath
from .richardson_lucy import Fit

if TYPE_CHECKING:
    from .volume import Volume

__all__ = [
    "SUFFIXES",
    "check_volume_file",
    "open_volume_file",
    "read_volume",
    "write_volume",
]

#: Endings of files of volumes.
SUFFIXES = (".tif", ".tiff", ".zarr")
# What files hold beside the voxels.
_FIELDS = ("spacing", "origin", "unit", "slopes", "pitch", "fits", "interval", "warnings")


@dataclass(frozen=True)
class _Stack:
    """Voxels of a volume (z, y, x), or of a time lapse (t, z, y, x), and what files tell of them."""

    data: Singles
    volume: Volume  # places, units and warnings, which all volumes have in common
    fits: list[Fit]  # of each volume
    interval: float | None = None  # of the volumes [s]

    @property
    def axes(self) -> str:
        """A letter for each axis."""
        return "tzyx"[-self.data.ndim :]

    @property
    def text(self) -> str:
        """The JSON text of the files."""
        about = {
            "software": "lfrender",
            "unit": self.volume.unit,
            "spacing": self.volume.spacing,
            "origin": self.volume.origin,
            "slopes": self.volume.slopes.tolist(),
            "pitch": self.volume.pitch,
            "fits": [vars(fit) for fit in self.fits],
            "interval": self.interval,
            "warnings": self.volume.warnings,
        }
        return json.dumps(about)


def check_volume_file(path: AnyPath) -> None:
    """Raise OutputError or PictureError if a volume could not be written."""
    check_output(path, SUFFIXES)
    check_format_package(path, FORMATS[Path(path).suffix.lower()])


def write_volume(path: AnyPath, volume: Volume) -> None:
    """Write a volume as the ending of the name asks; whole or not at all."""
    _write(path, _Stack(volume.data, volume, [volume.fit]))


@contextmanager
def open_volume_file(
    path: AnyPath, interval: float | None = None
) -> Iterator[Callable[[Volume], None]]:
    """A function that adds a volume to a file, which is written at the end; whole or not at all.

    Several volumes of one grid have an axis of time. They wait in a temporary file, not in memory.

    Parameters
    ----------
    path
        As for `Volume.save`.
    interval : float, optional [s]
        From one volume to the next.

    Examples
    --------
    >>> import tempfile, numpy as np
    >>> from lfrender import Volume
    >>> from lfrender.volume.files import open_volume_file
    >>> from lfrender.volume.richardson_lucy import Fit
    >>> places = {"spacing": (4.0, 2.5, 2.5), "origin": (-4.0, 0.75, 0.75), "unit": "px"}
    >>> places |= {"slopes": np.array([-4.0, 0.0, 4.0]), "pitch": 20.0}
    >>> volume = Volume(np.zeros((3, 32, 40)), fit=Fit(0.05, 0.04, 2, "2 steps"), **places)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open_volume_file(f"{folder}/lapse.ome.tif", interval=0.5) as add:
    ...         add(volume)
    ...         add(volume)
    ...     Volume.load(f"{folder}/lapse.ome.tif", frame=1) == volume
    True
    """
    check_volume_file(path)
    added: list[Volume] = []
    fits: list[Fit] = []
    with tempfile.TemporaryFile(dir=Path(path).parent) as file:

        def add(volume: Volume) -> None:
            places = {(one.data.shape, one.origin, one.spacing) for one in (*added, volume)}
            if len(places) > 1:
                raise ValueError("volume must be of the same grid as those before it")
            added[:] = [volume]
            fits.append(volume.fit)
            file.write(volume.data.tobytes())

        yield add
        file.flush()
        (volume,) = added
        shape = volume.data.shape
        if len(fits) > 1:
            shape = (len(fits), *shape)
        data = np.memmap(file, np.float32, "r", shape=shape)
        _write(path, _Stack(data, volume, fits, interval))


def read_volume(path: AnyPath) -> dict[str, Any]:
    """Voxels (`data`) and other fields of a written file, as `_Stack` has them; else a FlatError."""
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


def _write(path: AnyPath, stack: _Stack) -> None:
    target = Path(path)
    check_volume_file(target)
    if target.suffix.lower() == ".zarr":
        _write_zarr(target, stack)
    else:
        _write_tiff(target, stack)


def _write_zarr(path: Path, stack: _Stack) -> None:
    units = {}
    if stack.volume.unit == "um":
        units = dict.fromkeys("zyx", "micrometer")
    scale = list(stack.volume.spacing)
    first = list(stack.volume.origin)
    if "t" in stack.axes:
        scale.insert(0, stack.interval or 1.0)
        first.insert(0, 0.0)
        if stack.interval is not None:
            units["t"] = "second"
    write_ome_zarr(path, stack.data, stack.axes, scale, first, stack.text, units, levels=True)


def _write_tiff(path: Path, stack: _Stack) -> None:
    import tifffile

    metric = stack.volume.unit == "um"
    about: dict[str, Any] = {"axes": stack.axes.upper(), "Description": stack.text}
    for axis, size in zip("ZYX", stack.volume.spacing, strict=True):
        about[f"PhysicalSize{axis}"] = size
        about[f"PhysicalSize{axis}Unit"] = "µm" if metric else "pixel"
    if not metric:
        about["PhysicalSizeZUnit"] = "reference frame"
    if stack.interval is not None:
        about |= {"TimeIncrement": stack.interval, "TimeIncrementUnit": "s"}
    with atomic_write(path) as temporary:
        tifffile.imwrite(
            temporary,
            stack.data,
            ome=True,
            photometric="minisblack",
            software="lfrender",
            metadata=about,
        )
