"""Cameras in the forms other programs read: `RayCalibData` XML, key : value pairs, and a table of centres."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np

from ..camera.calibration import Calibration, load
from ..lattice.lattice import Lattice
from ..runtime.errors import CameraFileError
from ..runtime.output_file import atomic_write, check_output
from .published import parse_published
from .raytrix import write_raytrix

__all__ = ["convert", "read_camera"]

_SUFFIXES = {".json", ".xml", ".cfg", ".csv"}
_COLUMNS = ["i", "j", "x", "y"]
# Centres that a form puts further than this from where they are [px] are not kept by it.
_KEPT = 1e-3


def convert(calibration: Calibration, path: str | os.PathLike[str]) -> None:
    """Write a camera in the form its suffix names; the file appears whole or not at all.

    `.json` is our own form and keeps everything. `.xml` (`RayCalibData`) keeps lattice, radius and the three lens
    types of a hexagonal array, `.cfg` (key : value, with four corner centres) a hexagonal lattice, `.csv` the columns
    `i, j, x, y` of all centres.

    Raises
    ------
    OutputError
        If the suffix is of no known form or the file cannot be written.
    CameraFileError
        If the form cannot hold this lattice.
    """
    check_output(path, _SUFFIXES)
    suffix = Path(path).suffix.lower()
    if suffix == ".json":
        calibration.save(path)
        return
    text = (
        write_raytrix(calibration)
        if suffix == ".xml"
        else {".cfg": _as_pairs, ".csv": _as_table}[suffix](calibration.lattice)
    )
    if suffix != ".csv":
        _check_kept(calibration.lattice, parse_published(text, calibration.image_size, str(path)).lattice, str(path))
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read_camera(path: str | os.PathLike[str], image_size: tuple[int, int] | None = None) -> Calibration:
    """Read a camera in any form that `convert` writes.

    Parameters
    ----------
    path : path-like
    image_size : (int, int) or None [px]
        Width and height of the flats; needed for `.xml` and `.csv`, which do not say.

    Raises
    ------
    CameraFileError
        If the file is missing, damaged, of no known kind, or belongs to another image size.
    """
    if Path(path).suffix.lower() != ".csv":
        return load(path, image_size)
    if image_size is None:
        raise CameraFileError(f"{path}: does not say how large its flats are; give image_size as (width, height)")
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            rows = list(csv.reader(file))
        if not rows or [name.strip() for name in rows[0]] != _COLUMNS:
            raise ValueError(f"the first line is not {','.join(_COLUMNS)}")
        values = np.array([[float(cell) for cell in row] for row in rows[1:] if row])
        if values.ndim != 2 or values.shape[1] != 4 or not np.isfinite(values).all():
            raise ValueError("each line must hold four finite numbers")
        design = np.column_stack([np.ones(len(values)), values[:, :2]])
        if np.linalg.matrix_rank(design) < 3:
            raise ValueError("at least three centres that are not in one row are needed")
        origin, *basis = np.linalg.lstsq(design, values[:, 2:], rcond=None)[0]
        lattice = Lattice(origin, np.array(basis), image_size, 1.0)
        bent = float(np.linalg.norm(design @ np.vstack([origin, *basis]) - values[:, 2:], axis=1).max())
        warnings = (f"centres lie up to {bent:.3f} px off the straight lattice read",) if bent > _KEPT else ()
        return Calibration(Lattice(origin, np.array(basis), image_size, _inradius(lattice)), warnings=warnings)
    except (OSError, ValueError, csv.Error) as error:
        raise CameraFileError(f"{path}: cannot be read as a table of centres ({error})") from error


def _inradius(lattice: Lattice) -> float:
    return float(np.linalg.norm(lattice.steps @ lattice.basis, axis=1).min() / 2)


def _as_pairs(lattice: Lattice) -> str:
    """Key : value pairs with the centres of four microimages at the corners of a parallelogram."""
    if len(lattice.steps) != 6:
        raise CameraFileError("the key : value form holds hexagonal lattices only; write .xml, .csv or .json")
    steps = lattice.steps @ lattice.basis
    upright = np.abs(steps[:, 1]).max() > np.abs(steps[:, 0]).max()
    axis = 1 if upright else 0
    along = steps[steps[:, axis].argmax()]
    # Two rows further the microimages stand side by side again.
    sideways = max((2 * step - along for step in steps), key=lambda v: v[1 - axis] / np.hypot(*v))
    across, down = (sideways, along) if upright else (along, sideways)
    width, height = lattice.image_size
    columns, rows = (max(1, int(size / np.hypot(*v)) - 1) for size, v in ((width, across), (height, down)))
    first = lattice.origin + lattice.middle @ lattice.basis - (columns // 2) * across - (rows // 2) * down
    corners = {
        "LeftTop": first,
        "RightTop": first + columns * across,
        "LeftBottom": first + rows * down,
        "RightBottom": first + columns * across + rows * down,
    }
    lines = [f"LensletWidth : {width}", f"LensletHeight : {height}", f"MIDiameter : {lattice.pitch:.12f}"]
    lines.append(f"MLADirection : {int(upright)}")
    for name, corner in corners.items():
        lines += [f"{name}MICenterX : {corner[0]:.9f}", f"{name}MICenterY : {corner[1]:.9f}"]
    return "\n".join(lines) + "\n"


def _as_table(lattice: Lattice) -> str:
    """The columns `i, j, x, y` of all microimages whose centre lies on the flat."""
    rows = zip(lattice.indices(), lattice.centres(), strict=True)
    return ",".join(_COLUMNS) + "\n" + "".join(f"{i},{j},{x:.9f},{y:.9f}\n" for (i, j), (x, y) in rows)


def _check_kept(lattice: Lattice, again: Lattice, where: str) -> None:
    """CameraFileError where a form does not bring the same centres back."""
    index = again.to_index(lattice.centres())
    apart = (index - np.rint(index)) @ again.basis
    same_cell = abs(abs(np.linalg.det(again.basis) / np.linalg.det(lattice.basis)) - 1) < _KEPT
    if not same_cell or np.abs(apart).max() > _KEPT:
        raise CameraFileError(f"{where}: this form cannot hold the lattice to {_KEPT} px; write .json or .csv")
