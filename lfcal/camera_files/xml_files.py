"""The XML formats of published camera files: `RayCalibData`, which is also written, and `TSPCCalibData`.

In them y points up and angles turn counter-clockwise on the screen.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..camera.lens_types import LensTypes
from ..lattice.lattice import Lattice
from ..runtime.errors import CameraFileError
from .published import PublishedNumbers, calibration_from_corners, published_calibration, require_size

__all__ = ["format_xml", "parse_xml"]

_SAME_ANGLE = np.radians(1)  # files give six digits: angles further apart are not rounding


def parse_xml(text: str, image_size: tuple[int, int] | None) -> Calibration:
    """The camera in an XML file."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        root = fromstring(text)
    except (ParseError, DefusedXmlException, ValueError) as error:
        raise CameraFileError(f"not valid XML ({error})") from error
    size, numbers = require_size(image_size), PublishedNumbers(dict(_texts(root)))
    if root.tag == "RayCalibData":
        types = [PublishedNumbers(dict(_texts(element))) for element in root.findall("lens_type")]
        return _parse_raytrix(numbers, types, size)
    if root.tag == "TSPCCalibData":
        corners = [numbers.point(f"centers/{k}/x", f"centers/{k}/y") for k in ("ltop", "rtop", "lbot", "rbot")]
        upright = abs(np.sin(numbers.number("rotation"))) > np.sqrt(0.5)
        return calibration_from_corners(corners, numbers.positive("diameter"), upright, size)
    raise CameraFileError(f"<{root.tag}> is no known camera file; known are RayCalibData and TSPCCalibData")


def _texts(element: Any, place: str = "") -> Iterator[tuple[str, str]]:
    """Path and text of all elements inside one."""
    for child in element:
        yield place + child.tag, child.text or ""
        yield from _texts(child, f"{place}{child.tag}/")


def _parse_raytrix(numbers: PublishedNumbers, types: list[PublishedNumbers], size: tuple[int, int]) -> Calibration:
    """The camera in the numbers of a `RayCalibData` element and of the `lens_type` elements in it."""
    pitch, rotation = numbers.positive("diameter"), numbers.number("rotation")
    base = np.array([numbers.point(f"{name}/x", f"{name}/y") for name in ("lens_base_x", "lens_base_y")])
    if abs(np.linalg.det(base)) < 1e-3:
        raise CameraFileError("lens_base_x and lens_base_y do not span a lattice")
    warnings = []
    turned = float(np.arctan2(base[0, 1], base[0, 0]))
    if _angle_between(turned, rotation) < _angle_between(turned, 0.0):
        # The basis already contains the rotation.
        if _angle_between(rotation, 0.0) > _SAME_ANGLE:
            warnings.append("the rotation is given twice, in lens_base and in rotation; it was applied once")
        rotation = 0.0
    elif _angle_between(turned, 0.0) > _SAME_ANGLE:
        warnings.append("lens_base and rotation name two different angles; both were applied, check on a flat")
    cos, sin = np.cos(rotation), np.sin(rotation)
    to_pixels = np.array([[cos, sin], [-sin, cos]]) * pitch * [1, -1]
    origin = (np.array(size) - 1) / 2 + numbers.point("offset/x", "offset/y") * [1, -1]
    radius = pitch / 2 - (numbers.number("lens_border") if "lens_border" in numbers else 0.0)
    if radius <= 0:
        raise CameraFileError(f"radius must be positive, got {radius}")
    parameters = numbers.texts.get("distortion/parameter", "")
    if any(abs(float(v)) > 0 for v in parameters.replace(",", ";").split(";") if v.strip()):
        warnings.append("the file names a lens distortion, which is left out; calibrate on a flat for better")
    camera = published_calibration(origin, base @ to_pixels, size, radius, warnings)
    if len(types) < 2:
        return camera
    found = _types_at(np.array([one.point("offset/x", "offset/y") for one in types]) @ to_pixels, camera.lattice)
    warning = (
        "the lens types of the file do not lie on its lattice and are left out; calibrate on a flat"
        if found is None
        else "the order of the lens types in such files is often wrong and was not taken over; calibrate on a flat"
    )
    return replace(camera, lens_types=found, warnings=(*camera.warnings, warning))


def _types_at(offsets: NDArray[np.float64], lattice: Lattice) -> LensTypes | None:
    """Types of a hexagonal array from the positions (3, 2) [px] of one lens of each relative to the origin."""
    if len(offsets) != 3 or len(lattice.steps) != 6:
        return None
    index = offsets @ np.linalg.inv(lattice.basis)
    if np.abs(index - np.rint(index)).max() > 0.2:
        return None
    numbers = _type_numbers(np.rint(index).astype(int), lattice)
    if len(set(numbers.tolist())) != 3:
        return None
    i, j = np.meshgrid(np.arange(3), np.arange(3), indexing="ij")
    return LensTypes(np.argsort(numbers).astype(np.int8)[_type_numbers(np.stack([i, j], axis=-1), lattice)])


def _type_numbers(index: NDArray[np.int64], lattice: Lattice) -> NDArray[np.int64]:
    """(...) 0, 1 or 2 for indices (..., 2) of a hexagonal lattice: the one way in which no neighbours are alike."""
    along = 1 if ((lattice.steps.sum(1)) % 3 != 0).all() else -1
    return (index[..., 0] + along * index[..., 1]) % 3


def _angle_between(a: float, b: float) -> float:
    """Smallest difference of two angles [rad], which repeat every 60 degrees in a hexagonal lattice."""
    return float(abs((a - b + np.pi / 6) % (np.pi / 3) - np.pi / 6))


def format_xml(calibration: Calibration) -> str:
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
        text += f'  <lens_type id="{kind}">\n{lens}'
        if depths is not None:
            ends = "".join(f"      <{end}>{at:.12f}</{end}>\n" for end, at in zip(("min", "max"), depths, strict=True))
            text += f'    <depth_range units="virtual_depth">\n{ends}    </depth_range>\n'
        text += "  </lens_type>\n"
    return text


def _depth_ranges(types: LensTypes) -> list[tuple[float, float] | None]:
    """Nearest and farthest virtual depth of each type; types part half way between their foci in `s`."""
    assert types.focus is not None
    sizes = np.abs(types.focus)
    if not types.ordered or np.isnan(sizes).any() or not (np.diff(sizes) < 0).all():
        return [None] * types.count
    ends = [1.0, *(2 / (sizes[1:] + sizes[:-1])), 100.0]
    return [(float(near), float(far)) for near, far in pairwise(ends)]


def _pair(name: str, units: str, xy: NDArray[np.float64], indent: str = "  ") -> str:
    """An element with a child `x` and a child `y`."""
    values = "".join(f"{indent}  <{axis}>{value:.12f}</{axis}>\n" for axis, value in zip("xy", xy, strict=True))
    return f'{indent}<{name} units="{units}">\n{values}{indent}</{name}>\n'
