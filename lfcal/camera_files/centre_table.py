"""Tables of microimage centres: our own format, and tables of makers.

Our columns are `i,j,x,y,radius,type`. Tables of makers have lines and columns in any order.

Where a table has no indices `i, j` they are counted from neighbour to neighbour, which no
distortion misleads; lattice and distortion are robust least squares through the centres.
"""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from io import StringIO
from typing import Any

import numpy as np

from ..camera.calibration import Calibration
from ..camera.lens_types import LensTypes
from ..lattice.distortion import GENERAL_TERMS, Distortion
from ..lattice.lattice import Lattice, reduce_basis
from ..lattice.robust_fit import fit_affine
from ..runtime.arrays import Floats, Integers
from ..runtime.errors import CameraFileError
from ..runtime.types import Size
from .text_files import LARGEST

__all__ = ["ROUNDING", "format_centre_table", "parse_centre_table"]

_COLUMNS = ("x", "y", "radius", "type")
_OTHER_NAMES = {"cx": "x", "cy": "y", "r": "radius", "d": "diameter", "kind": "type"}

# [pitch] Distance of the centres from a lattice, RMS, beyond which they are none; [px] beyond which
# they are doubtful.
_MOST_RMS = 0.1
_DOUBTFUL_RMS = 0.2
# Share of the centres that steps of the lattice must lead to.
_LEAST_LINKED = 0.9
# Fewest centres that a distortion is fitted to, and the share of the misfit that may remain.
_FEWEST = 50
_LEAST_GAIN = 0.9
#: Distances of centres that come from rounding in a file [px].
ROUNDING = 1e-3
# Share of the lenses whose types must repeat.
_LEAST_REPEATING = 0.99


def parse_centre_table(text: str, size: Size, y_up: bool = False) -> Calibration:
    """Fit a lattice to the centres of a table.

    With `y_up`, y counts from the bottom of the flat.
    """
    try:
        table = _read_columns(text)
        centres = np.column_stack([table["x"], table["y"]])
        if y_up:
            centres[:, 1] = size[1] - 1 - centres[:, 1]
        named = "i" in table and "j" in table
        index = (
            np.rint(np.column_stack([table["i"], table["j"]])) if named else _find_indices(centres)
        )
        known = np.isfinite(index).all(1)
        lattice, rms = _fit_lattice(index[known], centres[known], size)
        if rms > _MOST_RMS * lattice.pitch:
            raise ValueError(f"the centres lie {rms:.2f} px (RMS) off any lattice")
    except (ValueError, np.linalg.LinAlgError) as error:
        raise CameraFileError(f"cannot be read as a table of centres ({error})") from error
    radius = lattice.radius
    if "radius" in table:
        radius = float(np.median(table["radius"]))
    types = None
    warnings = []
    if "type" in table and len(np.unique(table["type"])) > 1:
        types = _find_types(index[known].astype(np.int64), table["type"][known])
        problem = "a table does not say which lens type is focused at which depth"
        if types is None:
            problem = "the lens types of the table do not repeat on the lattice and are left out"
        warnings.append(f"{problem}; calibrate on a flat")
    if rms > _DOUBTFUL_RMS:
        warnings.append(
            f"the centres lie {rms:.2f} px (RMS) off the lattice read from them; calibrate "
            "on a flat"
        )
    return Calibration(
        lattice.with_radius(radius),
        residual_rms=rms,
        lenses_used=int(known.sum()),
        lens_types=types,
        warnings=tuple(warnings),
    )


def format_centre_table(calibration: Calibration) -> str:
    """Write the microimages whose centres lie on the flat as a table.

    The columns are `i, j, x, y, radius`, and `type` if the lens types are known.
    """
    lattice = calibration.lattice
    index = lattice.indices()
    radii = np.full(len(index), lattice.radius)
    columns = [index, lattice.centres(), radii]
    header = "i,j,x,y,radius"
    numbers = "%d,%d,%.9f,%.9f,%.9g"
    if calibration.lens_types is not None:
        columns.append(calibration.lens_types.of(index))
        header += ",type"
        numbers += ",%d"
    text = StringIO()
    np.savetxt(text, np.column_stack(columns), numbers, header=header, comments="")
    return text.getvalue()


def _read_columns(text: str) -> dict[str, Floats]:
    names: list[str] = []
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        cells = re.split(
            r"\s*[,;\s]\s*", re.sub(r"\[.*?\]|\(.*?\)|\"", "", line).strip("#,; \t").lower()
        )
        if cells == [""]:
            continue
        is_remark = line.lstrip().startswith("#")
        with suppress(ValueError):
            if not is_remark:
                rows.append([float(cell) for cell in cells])
                continue
        header = [re.sub(r"cent(re|er)|px|lens|[_.]", "", cell) for cell in cells]
        header = [_OTHER_NAMES.get(name, name) for name in header]
        if not rows and {"x", "y"} <= set(header):
            names = header
        elif not is_remark:
            raise ValueError(f"line {number} is neither numbers nor a header with x and y")
    names = names or list(_COLUMNS[: len(rows[0])] if rows else _COLUMNS)
    if (
        any(len(row) != len(names) for row in rows)
        or len(rows) < 3
        or not (np.abs(rows) <= LARGEST).all()
    ):
        numbers = f"{len(names)} numbers of at most {LARGEST:g}"
        raise ValueError(f"at least three lines of {numbers} are needed: {', '.join(names)}")
    table = dict(zip(names, np.array(rows).T, strict=True))
    if "diameter" in table:
        table["radius"] = table["diameter"] / 2
    return table


def _find_indices(centres: Floats) -> Floats:
    """(n, 2) lattice indices of centres, NaN of those that no step of the lattice leads to."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import breadth_first_order
    from scipy.spatial import cKDTree

    near = cKDTree(centres).query(centres, min(1 + 6, len(centres)))[1][:, 1:]
    steps = centres[near] - centres[:, None]
    middle = int(np.linalg.norm(centres - np.median(centres, axis=0), axis=1).argmin())
    first, *others = steps[middle]
    across = [
        v
        for v in others
        if abs(first[0] * v[1] - first[1] * v[0]) > 0.5 * np.hypot(*first) * np.hypot(*v)
    ]
    if not across:
        raise ValueError("the centres are in one row")
    basis = np.array([first, across[0]])
    for _ in range(3):
        index = steps @ np.linalg.inv(basis)
        whole = np.rint(index)
        good = (np.abs(index - whole).max(-1) < 0.25) & whole.any(-1)
        basis = np.linalg.lstsq(whole[good], steps[good], rcond=None)[0]
    basis = reduce_basis(basis)
    start = np.repeat(np.arange(len(centres)), near.shape[1]).reshape(near.shape)[good]
    graph = csr_matrix((np.ones(len(start)), (start, near[good])), (len(centres),) * 2)
    order, before = breadth_first_order(graph, middle, directed=False)
    if len(order) < max(4, _LEAST_LINKED * len(centres)):
        raise ValueError(
            f"{len(centres) - len(order)} of {len(centres)} centres lie on no lattice with "
            "the others"
        )
    found = np.full(centres.shape, np.nan)
    found[middle] = 0
    moves = np.rint((centres[order[1:]] - centres[before[order[1:]]]) @ np.linalg.inv(basis))
    for lens, move in zip(order[1:], moves, strict=True):
        found[lens] = found[before[lens]] + move
    return found


def _fit_lattice(index: Floats, centres: Floats, size: Size) -> tuple[Lattice, float]:
    design = np.column_stack([np.ones(len(index)), index])
    if np.linalg.matrix_rank(design) < 3:
        raise ValueError("at least three centres that are not in one row are needed")

    def rms(model: Floats, fit: Floats, weight: Floats) -> float:
        return float(np.sqrt(np.square(centres - model @ fit)[weight > 0].sum(1).mean()))

    straight, weight = fit_affine(design, centres, np.ones(len(index)))
    misfit = rms(design, straight, weight)
    bend = None
    if len(index) > _FEWEST and misfit > ROUNDING:
        zero = Distortion.zero(size)
        zero = replace(zero, general=np.zeros((2, GENERAL_TERMS)), middle=zero.centre)
        bent: Any = straight
        for _ in range(3):
            columns = [
                column for name, column in zero.derivatives(design @ bent[:3]) if name == "general"
            ]
            model = np.column_stack([design, *(column[:, 0] for column in columns[:GENERAL_TERMS])])
            bent, weight = fit_affine(model, centres, np.ones(len(index)))
        if rms(model, bent, weight) < _LEAST_GAIN * misfit:
            misfit = rms(model, bent, weight)
            straight = bent[:3]
            bend = replace(zero, general=bent[3:].T)
    lattice = Lattice(straight[0], straight[1:], size, 1.0, bend)
    return lattice.with_radius(
        float(np.linalg.norm(lattice.steps @ lattice.basis, axis=1).min() / 2)
    ), misfit


def _find_types(index: Integers, kinds: Floats) -> LensTypes | None:
    """Types as the smallest cell that repeats for 99 % of the lenses, None if there is none."""
    names, numbers = np.unique(kinds, return_inverse=True)
    for side in range(2, 8 + 1):
        votes = np.zeros((side, side, len(names)), np.int64)
        np.add.at(votes, (*(index % side).T, numbers.ravel()), 1)
        is_sampled = 4 * side**2 <= len(index) and votes.sum(2).all()
        if is_sampled and votes.max(2).sum() >= _LEAST_REPEATING * len(index):
            cell = votes.argmax(2)
            if len(np.unique(cell)) == len(names):
                return LensTypes(cell)
            return None
    return None
