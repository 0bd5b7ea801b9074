"""XML formats of published camera files.

`RayCalibData` is read and written, `TSPCCalibData` is read.

In them y points up and angles turn counter-clockwise on the screen.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..camera.calibration import Calibration
from ..camera.lens_types import LensTypes
from ..lattice.lattice import Lattice, reduce_basis
from ..runtime.arrays import Floats, Integers
from ..runtime.errors import CameraFileError
from ..runtime.types import Size
from .text_files import PublishedNumbers, calibration_from_corners

__all__ = ["format_xml", "parse_xml"]

# [pitch^2] Area of a cell, below which its sides are parallel; [pitch] offset of lenses of types.
_LEAST_AREA = 1e-3
_MOST_OFF = 0.2
_SAME_ANGLE = np.radians(1)  # files give six digits: angles further apart are not rounding


def parse_xml(text: str, size: Size) -> Calibration:
    """The camera in an XML file."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        root = fromstring(text)
        texts = dict(_texts(root))
    except RecursionError as error:
        raise CameraFileError("not a camera file: its elements are nested too deeply") from error
    except (ParseError, DefusedXmlException, ValueError) as error:
        raise CameraFileError(f"not valid XML ({error})") from error
    numbers = PublishedNumbers(texts)
    if root.tag == "RayCalibData":
        types = [PublishedNumbers(_texts(element)) for element in root.findall("lens_type")]
        return _parse_raytrix(numbers, types, size)
    if root.tag == "TSPCCalibData":
        corners = [
            numbers.point(f"centers/{k}/x", f"centers/{k}/y")
            for k in ("ltop", "rtop", "lbot", "rbot")
        ]
        upright = abs(np.sin(numbers.number("rotation"))) > np.sqrt(0.5)
        return calibration_from_corners(corners, numbers.positive("diameter"), upright, size)
    raise CameraFileError(
        f"<{root.tag}> is no known camera file; known are RayCalibData and TSPCCalibData"
    )


def _texts(element: Any, place: str = "") -> Iterator[tuple[str, str]]:
    for child in element:
        yield place + child.tag, child.text or ""
        yield from _texts(child, f"{place}{child.tag}/")


def _parse_raytrix(
    numbers: PublishedNumbers, types: list[PublishedNumbers], size: Size
) -> Calibration:
    pitch = numbers.positive("diameter")
    rotation = numbers.number("rotation")
    base = np.array(
        [numbers.point(f"{name}/x", f"{name}/y") for name in ("lens_base_x", "lens_base_y")]
    )
    if abs(np.linalg.det(base)) < _LEAST_AREA:
        raise CameraFileError("lens_base_x and lens_base_y do not span a lattice")
    warnings = []
    turned = float(np.arctan2(base[0, 1], base[0, 0]))
    if _angle_between(turned, rotation) < _angle_between(turned, 0.0):
        # The basis already contains the rotation.
        if _angle_between(rotation, 0.0) > _SAME_ANGLE:
            warnings.append(
                "the rotation is given twice, in lens_base and in rotation; it was applied once"
            )
        rotation = 0.0
    elif _angle_between(turned, 0.0) > _SAME_ANGLE:
        warnings.append(
            "lens_base and rotation name two different angles; both were applied, check on a flat"
        )
    cos = np.cos(rotation)
    sin = np.sin(rotation)
    to_pixels = np.array([[cos, sin], [-sin, cos]]) * pitch * [1, -1]
    origin = (np.array(size) - 1) / 2 + numbers.point("offset/x", "offset/y") * [1, -1]
    radius = pitch / 2 - (numbers.number("lens_border") if "lens_border" in numbers else 0.0)
    if radius <= 0:
        raise CameraFileError(f"radius must be positive, got {radius}")
    parameters = numbers.get("distortion/parameter", "")
    if any(abs(float(v)) > 0 for v in parameters.replace(",", ";").split(";") if v.strip()):
        warnings.append(
            "the file names a lens distortion, which is left out; calibrate on a flat for better"
        )
    lattice = Lattice(origin, reduce_basis(base @ to_pixels), size, radius)
    found = None
    if len(types) > 1:
        places = np.array([one.point("offset/x", "offset/y") for one in types])
        found = _types_at(places @ to_pixels, lattice)
        problem = "the order of the lens types in such files is often wrong and was not taken over"
        if found is None:
            problem = "the lens types of the file do not lie on its lattice and are left out"
        warnings.append(f"{problem}; calibrate on a flat")
    return Calibration(lattice, lens_types=found, warnings=tuple(warnings))


def _types_at(offsets: Floats, lattice: Lattice) -> LensTypes | None:
    """Lens types of a hexagonal array from one lens of each type.

    The positions (3, 2) [px] of these lenses are relative to the origin.
    """
    index = offsets @ np.linalg.inv(lattice.basis)
    numbers = _type_numbers(np.rint(index).astype(int), lattice)
    three = len(offsets) == len(set(numbers.tolist())) == 3 and len(lattice.steps) == 6
    if not three or np.abs(index - np.rint(index)).max() > _MOST_OFF:
        return None
    i, j = np.meshgrid(np.arange(3), np.arange(3), indexing="ij")
    return LensTypes(
        np.argsort(numbers).astype(np.int8)[_type_numbers(np.stack([i, j], axis=-1), lattice)]
    )


def _type_numbers(index: Integers, lattice: Lattice) -> Integers:
    """Type 0, 1 or 2 (...) of the lenses with indices (..., 2) of a hexagonal lattice.

    This is the only arrangement in which all neighbours have different types.
    """
    along = -1
    if ((lattice.steps.sum(1)) % 3 != 0).all():
        along = 1
    return (index[..., 0] + along * index[..., 1]) % 3


def _angle_between(a: float, b: float) -> float:
    """Smallest difference of two angles [rad] of a hexagonal lattice.

    A hexagonal lattice repeats every 60 degrees.
    """
    return float(abs((a - b + np.pi / 6) % (np.pi / 3) - np.pi / 6))


def format_xml(calibration: Calibration) -> str:
    """A camera as `RayCalibData`: the basis lies along x before the rotation turns it.

    Lens types are kept where there are three in a hexagonal array; their ranges of depth where
    their focus is known.
    """
    lattice = calibration.lattice
    up = lattice.basis * [1, -1]
    rotation = float(np.arctan2(up[0, 1], up[0, 0]))
    cos = np.cos(rotation)
    sin = np.sin(rotation)
    to_lens = np.array([[cos, -sin], [sin, cos]]) / lattice.pitch
    base = up @ to_lens
    base[0, 1] = 0.0
    middle = lattice.middle
    offset = (lattice.origin + middle @ lattice.basis - (np.array(lattice.image_size) - 1) / 2) * [
        1,
        -1,
    ]
    elements = [
        _element("offset", "pix", x=offset[0], y=offset[1]),
        f'<diameter units="pix">{lattice.pitch:.12f}</diameter>',
        f'<rotation units="rad">{rotation:.12f}</rotation>',
        f'<lens_border units="pix">{lattice.pitch / 2 - lattice.radius:.12f}</lens_border>',
        _element("lens_base_x", "lens", x=base[0, 0], y=base[0, 1]),
        _element("lens_base_y", "lens", x=base[1, 0], y=base[1, 1]),
        *_type_elements(calibration.lens_types, lattice, middle, to_lens),
    ]
    root = ElementTree.fromstring(f'<RayCalibData version="1.0">{"".join(elements)}</RayCalibData>')
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _type_elements(
    types: LensTypes | None,
    lattice: Lattice,
    middle: Integers,
    to_lens: Floats,
) -> Iterator[str]:
    """XML elements of three lens types: one lens of each, and its range of depths.

    The lenses are those nearest to `middle` (2,). The ranges meet half-way in `s`.
    """
    steps = np.vstack([np.zeros((1, 2), dtype=int), lattice.steps])
    if types is None or types.focus is None or types.count != 3 or len(lattice.steps) != 6:
        return
    kinds = types.of(middle + steps)
    if set(kinds.tolist()) != {0, 1, 2}:
        return
    sizes = np.abs(types.focus)
    known = types.ordered and (np.diff(sizes) < 0).all()
    ends = [1.0, *(2 / (sizes[1:] + sizes[:-1])), 100.0]
    yield _element("sub_grid_base", "lens", x=3.0, y=np.sqrt(3.0))
    for kind in range(3):
        x, y = (steps[np.flatnonzero(kinds == kind)[0]] @ lattice.basis * [1, -1]) @ to_lens
        depths = ""
        if known:
            depths = _element("depth_range", "virtual_depth", min=ends[kind], max=ends[kind + 1])
        yield f'<lens_type id="{kind}">{_element("offset", "lens", x=x, y=y)}{depths}</lens_type>'


def _element(name: str, units: str, **children: float) -> str:
    values = "".join(f"<{child}>{value:.12f}</{child}>" for child, value in children.items())
    return f'<{name} units="{units}">{values}</{name}>'
