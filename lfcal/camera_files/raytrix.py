"""`RayCalibData`, the camera files of Raytrix: y points up in them, angles turn counter-clockwise on the screen."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..camera.lens_types import LensTypes
from ..lattice.lattice import Lattice
from ..runtime.errors import CameraFileError
from .xml_fields import make_camera, read_number, read_point, require_positive

__all__ = ["parse_raytrix", "write_raytrix"]

_SIXTH = np.pi / 3
# Angles in files are given to six digits or more; a degree apart is no rounding.
_SAME_ANGLE = np.radians(1.0)
# Lens types lie at whole lattice indices; further off than this they belong to another lattice.
_WHOLE = 0.2
# Virtual depths that the files give as the nearest and the farthest.
_NEAREST, _FARTHEST = 1.0, 100.0


def parse_raytrix(root: Any, image_size: tuple[int, int], where: str) -> Calibration:
    """The camera in a `RayCalibData` element; errors begin with `where`."""
    pitch = require_positive(read_number(root, "diameter", where), "diameter", where)
    rotation = read_number(root, "rotation", where)
    base = np.array([read_point(root, "lens_base_x", where), read_point(root, "lens_base_y", where)])
    if abs(np.linalg.det(base)) < 1e-3:
        raise CameraFileError(f"{where}: lens_base_x and lens_base_y do not span a lattice")
    warnings = []
    turned = float(np.arctan2(base[0, 1], base[0, 0]))
    if _apart(turned, rotation) < _apart(turned, 0.0):
        # The basis already contains the rotation.
        if _apart(rotation, 0.0) > _SAME_ANGLE:
            warnings.append("the rotation is given twice, in lens_base and in rotation; it was applied once")
        turn = 0.0
    else:
        turn = rotation
        if _apart(turned, 0.0) > _SAME_ANGLE:
            warnings.append("lens_base and rotation name two different angles; both were applied, check on a flat")
    cos, sin = np.cos(turn), np.sin(turn)
    up = base @ np.array([[cos, sin], [-sin, cos]]) * pitch
    offset = read_point(root, "offset", where)
    origin = (np.array(image_size) - 1) / 2 + offset * [1, -1]
    border = root.find("lens_border")
    radius = pitch / 2 - (read_number(root, "lens_border", where) if border is not None else 0.0)
    if _distorted(root):
        warnings.append("the file names a lens distortion, which is left out; calibrate on a flat for better")
    camera = make_camera(origin, up * [1, -1], image_size, require_positive(radius, "radius", where), warnings)
    offsets = [read_point(element, "offset", where) for element in root.findall("lens_type")]
    if len(offsets) < 2:
        return camera
    types = _types_at(np.array(offsets) @ np.array([[cos, sin], [-sin, cos]]) * [pitch, -pitch], camera.lattice)
    words = (
        "the lens types of the file do not lie on its lattice and are left out; calibrate on a flat"
        if types is None
        else "the order of the lens types in such files is often wrong and was not taken over; calibrate on a flat"
    )
    return replace(camera, lens_types=types, warnings=(*camera.warnings, words))


def _types_at(offsets: NDArray[np.float64], lattice: Lattice) -> LensTypes | None:
    """Types of a hexagonal array from the places (3, 2) [px] of one lens of each against the origin."""
    if len(offsets) != 3 or len(lattice.steps) != 6:
        return None
    index = offsets @ np.linalg.inv(lattice.basis)
    if np.abs(index - np.rint(index)).max() > _WHOLE:
        return None
    sort = _sorts(np.rint(index).astype(int), lattice)
    if len(set(sort.tolist())) != 3:
        return None
    i, j = np.meshgrid(np.arange(3), np.arange(3), indexing="ij")
    return LensTypes(np.argsort(sort).astype(np.int8)[_sorts(np.stack([i, j], axis=-1), lattice)])


def _sorts(index: NDArray[np.int64], lattice: Lattice) -> NDArray[np.int64]:
    """(...) 0, 1 or 2 for indices (..., 2) of a hexagonal lattice: the one way in which no neighbours are alike."""
    along = 1 if ((lattice.steps.sum(1)) % 3 != 0).all() else -1
    return (index[..., 0] + along * index[..., 1]) % 3


def _distorted(root: Any) -> bool:
    text = root.findtext("distortion/parameter") or ""
    return any(abs(float(v)) > 0 for v in text.replace(",", ";").split(";") if v.strip())


def _apart(a: float, b: float) -> float:
    """Smallest difference of two angles [rad] that a hexagonal lattice can tell."""
    difference = (a - b) % _SIXTH
    return min(difference, _SIXTH - difference)


def write_raytrix(calibration: Calibration) -> str:
    """A camera as `RayCalibData`: the basis lies along x before the rotation turns it.

    Lens types are kept where there are three in a hexagonal array; their ranges of depth where their focus is known.
    """
    lattice = calibration.lattice
    up = lattice.basis * [1, -1]
    rotation = float(np.arctan2(up[0, 1], up[0, 0]))
    cos, sin = np.cos(rotation), np.sin(rotation)
    to_lens = np.array([[cos, -sin], [sin, cos]]) / lattice.pitch
    base = up @ to_lens
    base[0, 1] = 0.0
    middle = lattice.middle
    offset = (lattice.origin + middle @ lattice.basis - (np.array(lattice.image_size) - 1) / 2) * [1, -1]
    return (
        '<?xml version="1.0"?>\n<RayCalibData version="1.0">\n'
        + _pair("offset", "pix", offset)
        + f'  <diameter units="pix">{lattice.pitch:.12f}</diameter>\n'
        + f'  <rotation units="rad">{rotation:.12f}</rotation>\n'
        + f'  <lens_border units="pix">{lattice.pitch / 2 - lattice.radius:.12f}</lens_border>\n'
        + _pair("lens_base_x", "lens", base[0])
        + _pair("lens_base_y", "lens", base[1])
        + _types_xml(calibration.lens_types, lattice, middle, to_lens)
        + "</RayCalibData>\n"
    )


def _types_xml(
    types: LensTypes | None, lattice: Lattice, middle: NDArray[np.int64], to_lens: NDArray[np.float64]
) -> str:
    """The rectangle after which three lens types repeat, and one lens of each next to the index `middle` (2,)."""
    if types is None or types.count != 3 or len(lattice.steps) != 6:
        return ""
    steps = np.vstack([np.zeros((1, 2), dtype=int), lattice.steps])
    kinds = types.of(middle + steps)
    if set(kinds.tolist()) != {0, 1, 2}:
        return ""
    text = _pair("sub_grid_base", "lens", np.array([3.0, np.sqrt(3.0)]))
    for kind, depths in enumerate(_depth_ranges(types)):
        step = steps[np.flatnonzero(kinds == kind)[0]]
        lens = _pair("offset", "lens", (step @ lattice.basis * [1, -1]) @ to_lens, "    ")
        ends = (
            ""
            if depths is None
            else "".join(
                f"      <{name}>{depth:.12f}</{name}>\n" for name, depth in zip(("min", "max"), depths, strict=True)
            )
        )
        seen = f'    <depth_range units="virtual_depth">\n{ends}    </depth_range>\n' if ends else ""
        text += f'  <lens_type id="{kind}">\n{lens}{seen}  </lens_type>\n'
    return text


def _depth_ranges(types: LensTypes) -> list[tuple[float, float] | None]:
    """Nearest and farthest virtual depth of each type; types part half way between their foci in `s`."""
    assert types.focus is not None
    sizes = np.abs(types.focus)
    if not types.ordered or np.isnan(sizes).any() or not (np.diff(sizes) < 0).all():
        return [None] * types.count
    ends = [_NEAREST, *(2 / (sizes[1:] + sizes[:-1])), _FARTHEST]
    return [(float(near), float(far)) for near, far in pairwise(ends)]


def _pair(name: str, units: str, xy: NDArray[np.float64], indent: str = "  ") -> str:
    """An element with a child `x` and a child `y`."""
    values = "".join(f"{indent}  <{axis}>{value:.12f}</{axis}>\n" for axis, value in zip("xy", xy, strict=True))
    return f'{indent}<{name} units="{units}">\n{values}{indent}</{name}>\n'
