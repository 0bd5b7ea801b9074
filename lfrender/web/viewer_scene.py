"""The data of the viewer's shader: tiles of the flat, depth of its pixels, tables."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Calibration, LightFieldError

from ..data.depth_map import DepthMap, check_depth, default_scale
from ..data.depth_order import depth_limits, depth_order, name_ends, slider_limits
from ..data.surface import edge_step
from ..detail.blur import averaged_squares, choose_blur, shows_both_modes
from ..flat.gray_flat import correction_tables, has_uneven_lenses
from ..flat.lens_graph import lens_displacements, lens_offsets, nearest_lens
from ..flat.lens_type_weights import WEIGHT_RATIOS, focus_weights
from ..flat.validation import check_flat
from ..output.depth_picture import DEPTH_SCALE, colour_scale
from ..output.finish import Finish, flat_picture
from ..rendering.blend.lit_flat import dilate_mask
from ..rendering.blend.occlusion import project_surface
from ..rendering.renderer import AGREEMENT, REACH, REFOCUS_REACH, VIEW_REACH
from ..rendering.traditional import traditional
from ..rendering.warped_surface import Viewpoint, virtual_depth
from .report_pictures import encode_picture

__all__ = ["viewer_scene"]

# Codes of the patch sizes of flat pixels, of 16 bits: 0 is unknown, the last one infinitely far,
# the others -D to D.
_CODES = 65535
# Layers of textures that every WebGL 2 has; each has 2048 x 2048 pixels.
_LAYERS = 256
# Lenses whose depths differ by less than this are one thing in focus [pitches].
_SAME_DEPTH = 0.03
# Weight of a lens without confidence, so that a flat without any has a middle.
_LEAST_WEIGHT = 1e-3


def viewer_scene(
    flat: NDArray,
    calibration: Calibration,
    depth: DepthMap,
    title: str,
    *,
    tile: int = 2048,
    compression: int = 1,
) -> Iterator[tuple[str, bytes]]:
    """The data of the viewer: names and contents of a JSON object, pictures and arrays.

    These are `scene.json`, `surface.f32`, `confidence.u8`, `flat-COLUMN-ROW.png` (8 bits per
    channel), `occlusion- COLUMN-ROW.png`, `traditional.png` and, where the optics of the camera are
    known, `positions.f32`. `tile` is the largest side of a texture [px], `compression` of the PNG
    files is 0 to 9. Errors as of `render`, and LightFieldError if the flat needs more tiles than
    browsers take.
    """
    pixels = check_flat(flat, calibration)
    check_depth(depth, calibration)
    height, width = pixels.shape[:2]
    side, places = _tiles((width, height), tile)
    if len(places) > _LAYERS:
        raise LightFieldError(
            f"a flat of {width} x {height} px needs {len(places)} textures, browsers take "
            f"{_LAYERS}; view a part of it, or a smaller copy"
        )
    edge = edge_step(calibration.lattice.pitch)
    (gains, *_), step = correction_tables(calibration)
    rings = [gains, 1 / gains]
    even = pixels
    if has_uneven_lenses(calibration, types=True):
        # The flat is corrected if its lenses differ.
        even, rings[0] = calibration.flatten(pixels), np.ones_like(gains)
    codes, central_codes = _occlusion_codes(calibration, depth, edge)
    scene = _tables(calibration, depth, edge, pixels)
    scene |= {"title": title, "size": [width, height], "metric": calibration.optics is not None}
    scene["rings"] = {"step": step, "values": _base64(np.column_stack(rings), np.float32)}
    with_occlusion = []
    finish = Finish("flat.webp").measured(flat_picture(pixels, calibration))
    for name, (x, y) in places.items():
        part = _cut(codes, x, y, side)
        if part.any():
            with_occlusion.append(name)
            coded = np.dstack([part >> 8, part & 255, _cut(central_codes, x, y, side)]).astype(
                np.uint8
            )
            yield f"occlusion-{name}.png", encode_picture(coded, ".png", compression)
        shown = finish.apply(flat_picture(_cut(even, x, y, side), calibration)).image
        yield f"flat-{name}.png", encode_picture(shown, ".png", compression)
    plain = traditional(flat, calibration)
    shown = finish.apply(plain).image
    yield "traditional.png", encode_picture(shown, ".png", compression)
    scene["traditional"] = {"first": plain.affine[:, 2], "shape": plain.image.shape[:2]}
    columns, rows = (len(set(ends)) for ends in zip(*places.values(), strict=True))
    scene["tiles"] = {"side": side, "columns": columns, "rows": rows, "occlusion": with_occlusion}
    surface = depth.surface
    yield "surface.f32", np.ascontiguousarray(surface.patch_size, "<f4").tobytes()
    v, u = np.indices(surface.patch_size.shape)
    points = (
        np.column_stack([u.ravel(), v.ravel()]).astype(np.float64) * surface.spacing + surface.first
    )
    # 0 is filled in, others from 1.
    sure = np.rint(1 + (255 - 1) * np.clip(np.nan_to_num(depth.confidence), 0, 1))
    known = np.where(depth.filled, 0, sure)
    yield (
        "confidence.u8",
        known.astype(np.uint8)[nearest_lens(calibration.lattice.centres(), points)].tobytes(),
    )
    if calibration.optics is not None:
        # Where scene points lie in front of the main lens [m]; NaN at infinity.
        ratio = surface.patch_size.ravel().astype(np.float64) / depth.pitch
        at = calibration.optics.positions(points, ratio, (np.array(depth.image_size) - 1) / 2)
        at = np.where(np.isfinite(at).all(1, keepdims=True), at, np.nan)
        yield "positions.f32", at.astype("<f4").tobytes()
    yield "scene.json", json.dumps(scene, default=lambda values: values.tolist()).encode()


def _tiles(size: tuple[int, int], largest: int) -> tuple[int, dict[str, tuple[int, int]]]:
    """Side of the tiles [px], and left and top of each by its name `COLUMN-ROW`.

    Neighbours share three rows or columns, one of them before their own part: each is interpolated
    and sharpened alone.
    """
    side = min(largest, max(*size, 2) + 2)
    step = side - 3
    columns, rows = (max(1, -(-(n - 1) // step)) for n in size)
    return side, {
        f"{i}-{j}": (i * step - 1, j * step - 1) for j in range(rows) for i in range(columns)
    }


def _cut(pixels: NDArray, left: int, top: int, side: int) -> NDArray:
    """A tile that reaches one pixel beyond the flat, whose last pixels are repeated there."""
    starts = zip((top, left), pixels.shape, strict=False)
    rows, columns = (np.arange(low, min(low + side, n + 1)).clip(0, n - 1) for low, n in starts)
    return pixels[rows[:, None], columns]


def _occlusion_codes(
    calibration: Calibration, depth: DepthMap, edge: float
) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """(H, W) codes of the patch size at each flat pixel, for any view and the central one.

    For other viewpoints, lenses are read at places farther from them. The second code is 0 for
    unknown, 255 for the same as the first, else -D to D.
    """
    lattice = calibration.lattice
    farthest = Viewpoint((lattice.radius, 0.0)).max_parallax(depth.surface, lattice)
    middle, _ = project_surface(depth.surface, lattice, REACH * lattice.pitch, edge)
    aside, _ = project_surface(depth.surface, lattice, REACH * lattice.pitch + farthest, edge)
    coded = _encode(aside, lattice.pitch, _CODES).astype(np.uint16)
    central = _encode(middle, lattice.pitch, 255).astype(np.uint8)
    central[np.abs(middle - aside) < 0.5 * edge] = 255
    if has_uneven_lenses(calibration):
        unlit = dilate_mask(np.isnan(calibration.gain()))
        coded[unlit], central[unlit] = _CODES, 255
    return coded, central


def _encode(patch_size: NDArray[np.float32], pitch: float, last: int) -> NDArray[np.float32]:
    """Integer codes: 0 for NaN, 1 to `last - 1` for -D to D."""
    share = (np.clip(np.nan_to_num(patch_size) / pitch, -1, 1) + 1) / 2
    return np.where(np.isnan(patch_size), 0, np.rint(1 + share * (last - 2))).astype(np.float32)


def _tables(
    calibration: Calibration, depth: DepthMap, edge: float, pixels: NDArray
) -> dict[str, Any]:
    """The tables in the JSON object."""
    lattice = calibration.lattice
    surface = depth.surface
    offsets, _ = lens_offsets(lattice, REFOCUS_REACH * lattice.pitch)
    displacements, low = lens_displacements(lattice)
    cell, shares = focus_weights(calibration.lens_types)
    blur = choose_blur(calibration, depth)
    both = shows_both_modes(surface.patch_size)
    averaged = averaged_squares(calibration, blur, WEIGHT_RATIOS, both)
    virtual = virtual_depth(surface.patch_size, lattice.pitch)
    ends, middle = _planes(depth)
    limits = depth_limits(depth)
    moved = {
        "shape": displacements.shape[:2],
        "low": low,
        "values": _base64(displacements, np.float32),
    }
    return {
        "pitch": lattice.pitch,
        "radius": lattice.radius,
        "origin": lattice.origin,
        "basis": lattice.basis,
        "inverse": np.linalg.inv(lattice.basis),
        "offsets": _base64(offsets, np.float32),
        "displacements": moved,
        "types": {
            "side": len(cell),
            "cell": cell.ravel(),
            "shares": _base64(shares, np.float32),
        },
        "surface": {
            "shape": surface.patch_size.shape,
            "first": surface.first,
            "spacing": surface.spacing,
            "edge": edge,
            "virtual": [virtual.min(), virtual.max()],
        },
        # Areas [px^2] over the same `s / D` as the shares of types.
        "averaged": _base64(averaged, np.float32),
        "scale": default_scale(depth),
        "agreement": AGREEMENT,
        "planes": ends,
        "plane": middle,
        "reach": {"sharp": REACH, "aside": VIEW_REACH, "wide": REFOCUS_REACH},
        "overlay": {
            "limits": limits,
            "ends": name_ends(limits),
            "ramp": _base64(colour_scale(DEPTH_SCALE), np.uint8),
        },
    }


def _planes(depth: DepthMap) -> tuple[list[float], float]:
    """Ends of the slider of depth, and the patch size that the page opens with.

    In focus is the largest thing with texture: the depth at which most lenses lie, weighted by
    their confidence. Depths are `s` of telescopic and `s + 2 D` of binocular lenses, which grows
    toward the camera.
    """
    resolved = np.isfinite(depth.patch_size)
    resolved |= not resolved.any()
    known = depth.filled_patch_size[resolved].astype(float)
    pitch = depth.pitch
    near = pitch * depth_order(known, pitch)
    order = np.argsort(near)
    near = near[order]
    weights = np.maximum(np.nan_to_num(depth.confidence[resolved][order]), _LEAST_WEIGHT)
    summed = np.concatenate([[0.0], np.cumsum(weights)])
    first, last = (np.searchsorted(near, near + side * _SAME_DEPTH * pitch) for side in (-1, 1))
    middle = near[np.argmax(summed[last] - summed[first])]
    limits = [pitch * end for end in slider_limits(depth)]
    middle = float(np.clip(middle, limits[0], limits[1]))
    return limits, middle if middle < pitch else middle - 2 * pitch


def _base64(values: ArrayLike, dtype: Any) -> str:
    return base64.b64encode(
        np.ascontiguousarray(values, np.dtype(dtype).newbyteorder("<")).tobytes()
    ).decode()
