"""Tables of microimage centres, `i,j,x,y`: written for any lattice, read as the straight lattice through them."""

from __future__ import annotations

import csv

import numpy as np

from ..camera.calibration import Calibration
from ..lattice.lattice import Lattice
from ..runtime.errors import CameraFileError

__all__ = ["CENTRE_TOLERANCE", "HEADER", "format_centre_table", "parse_centre_table"]

HEADER = "i,j,x,y"
#: [px] a format that moves centres further cannot hold the lattice.
CENTRE_TOLERANCE = 1e-3


def parse_centre_table(text: str, image_size: tuple[int, int] | None) -> Calibration:
    """Least-squares lattice through the centres of a table."""
    if image_size is None:
        raise CameraFileError("has no image size; give image_size as (width, height)")
    try:
        rows = list(csv.reader(text.splitlines()))
        if not rows or [name.strip() for name in rows[0]] != HEADER.split(","):
            raise ValueError(f"the first line is not {HEADER}")
        values = np.array([[float(cell) for cell in row] for row in rows[1:] if row])
        if values.ndim != 2 or values.shape[1] != 4 or not np.isfinite(values).all():
            raise ValueError("each line must hold four finite numbers")
        design = np.column_stack([np.ones(len(values)), values[:, :2]])
        if np.linalg.matrix_rank(design) < 3:
            raise ValueError("at least three centres that are not in one row are needed")
        origin, *basis = np.linalg.lstsq(design, values[:, 2:], rcond=None)[0]
        steps = Lattice(origin, np.array(basis), image_size, 1.0).steps @ np.array(basis)
        radius = float(np.linalg.norm(steps, axis=1).min() / 2)
        misfit = float(np.linalg.norm(design @ np.vstack([origin, *basis]) - values[:, 2:], axis=1).max())
        warning = f"centres lie up to {misfit:.3f} px off the straight lattice read"
        return Calibration(
            Lattice(origin, np.array(basis), image_size, radius),
            warnings=(warning,) if misfit > CENTRE_TOLERANCE else (),
        )
    except (ValueError, csv.Error) as error:
        raise CameraFileError(f"cannot be read as a table of centres ({error})") from error


def format_centre_table(lattice: Lattice) -> str:
    """The columns `i, j, x, y` of all microimages whose centre lies on the flat."""
    rows = zip(lattice.indices(), lattice.centres(), strict=True)
    return HEADER + "\n" + "".join(f"{i},{j},{x:.9f},{y:.9f}\n" for (i, j), (x, y) in rows)
