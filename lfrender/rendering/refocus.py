"""Pictures in focus at one depth, as a camera with the aperture of the main lens would have taken
them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.errors import check_type

from ..data.depth_map import DEPTH_ADVICE, DepthMap, check_depth, default_scale
from ..data.rendering import Rendering, check_patch_size, check_scale, finish_picture
from ..data.surface import constant_surface
from ..detail.blur import choose_blur
from ..flat.validation import check_flat
from .depth_blur import DepthBlur
from .renderer import REFOCUS_REACH, Renderer
from .warped_surface import virtual_depth

__all__ = ["focal_stack", "refocus", "stack_depths"]


def refocus(
    flat: NDArray,
    calibration: Calibration,
    patch_size: float | None = None,
    *,
    position: tuple[float, float] | None = None,
    depth: DepthMap | None = None,
    aperture: float = 1.0,
    scale: float | None = None,
) -> Rendering:
    """Draw the scene in focus at one depth, out of focus in front of it and behind.

    Every scene point is the mean over all lenses that show it, read at one patch size for all
    places (integral photography: Lumsdaine and Georgiev 2008, section 5). Where lenses are too few
    for even blur, they repeat detail as a mesh; with a depth map, the picture of `render` is
    blurred there by its depth instead. Errors are those of `render`.

    Parameters
    ----------
    flat, calibration
        As for `render`.
    patch_size : float, optional [px]
        Signed patch size in focus.
    position : (float, float), optional [px]
        Scene coordinates `X` of a place to focus on, instead of `patch_size`.
    depth : DepthMap, optional
        Of this flat, for `position` and for even blur; analysed for `position` where it is not
        given.
    aperture : float
        Part of the radius of the microimages, and so of the main lens' aperture, that takes part:
        0.05 to 1. Less gives more depth of field.
    scale : float, optional
        Output pixels per pitch; by default that of `render` for this depth map, `|patch_size|`
        without one.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice
    >>> camera = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (400, 300), 9))
    >>> flat = np.full((300, 400), 100, np.uint8)
    >>> refocus(flat, camera, patch_size=-4, aperture=0.5).image.shape
    (60, 80)
    """
    pixels = check_flat(flat, calibration)
    lattice = calibration.lattice
    if (patch_size is None) == (position is None):
        raise ValueError("give one of patch_size and position")
    if position is not None:
        place = np.array(position, dtype=float)
        width, height = lattice.image_size
        if (
            place.shape != (2,)
            or not ((place >= -0.5) & (place <= (width - 0.5, height - 0.5))).all()
        ):
            given = " ".join(map(str, np.ravel(position)))
            raise ValueError(
                f"position must be x, y on the flat of {width} x {height} px, got {given}"
            )
        if depth is None:
            from ..depth.analyze import analyze

            depth = analyze(pixels, calibration)
        patch_size = float(depth.surface.at(place[None])[0])
    assert patch_size is not None
    if scale is None:
        scale = abs(patch_size) if depth is None else default_scale(depth)
    return _Refocused(flat, pixels, calibration, depth, aperture, scale).draw(patch_size)


def focal_stack(
    flat: NDArray,
    calibration: Calibration,
    patch_sizes: Iterable[float],
    *,
    depth: DepthMap | None = None,
    aperture: float = 1.0,
    scale: float | None = None,
) -> list[Rendering]:
    """Draw the scene in focus at several signed patch sizes [px], at least one, all pictures on one
    grid.

    That is the grid of `render` for a depth map, if one is given; else the scale is the largest
    `|patch_size|`. The rest is as for `refocus`.

    Examples
    --------
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> stack = lfrender.focal_stack(flat, camera, [-7.0, 7.0], scale=6)
    >>> [picture.image.shape for picture in stack]
    [(47, 62, 3), (47, 62, 3)]
    """
    check_type(
        patch_sizes, Iterable, "patch_sizes", "give signed patch sizes [px], as stack_depths does"
    )
    sizes = [float(s) for s in patch_sizes]
    if not sizes:
        raise ValueError("patch_sizes must hold at least one number")
    if scale is None:
        scale = max(map(abs, sizes)) if depth is None else default_scale(depth)
    pixels = check_flat(flat, calibration)
    stack = _Refocused(flat, pixels, calibration, depth, aperture, scale)
    return list(map(stack.draw, sizes))


@dataclass(frozen=True, eq=False)
class _Refocused:
    """What refocused pictures of one flat share."""

    flat: NDArray
    pixels: NDArray  # the same by `check_flat`
    calibration: Calibration
    depth: DepthMap | None
    aperture: float
    scale: float

    @cached_property
    def blur(self) -> DepthBlur | None:
        """The picture that is sharp everywhere, on the same grid, if the depth is known."""
        if self.depth is None:
            return None
        check_depth(self.depth, self.calibration)
        lattice = self.calibration.lattice
        renderer = Renderer(self.calibration, self.depth.surface, self.scale, True)
        sharp, _ = renderer.draw(self.pixels)
        depth = virtual_depth(renderer.seen_depth(), lattice.pitch)
        radius = self.aperture * lattice.radius
        return DepthBlur(sharp, depth, self.scale, radius, lattice.pitch)

    def draw(self, patch_size: float) -> Rendering:
        """The picture in focus at one patch size [px]."""
        calibration = self.calibration
        lattice = calibration.lattice
        check_patch_size(patch_size, lattice.pitch)
        # Below, a scene point may lie between what all microimages show.
        if not 0.05 <= self.aperture <= 1:
            raise ValueError(f"aperture must lie between 0.05 and 1, got {self.aperture:g}")
        # Out of focus, colours differ and are mixed all the same.
        renderer = Renderer(
            calibration,
            constant_surface(patch_size),
            check_scale(self.scale, lattice.pitch),
            True,
            reach=REFOCUS_REACH,
            agreement=1e3,
            aperture=self.aperture,
            lens_blur=None if self.depth is None else choose_blur(calibration, self.depth),
        )
        blur = self.blur
        if blur is None:
            image, valid = renderer.draw(self.pixels, dtype=self.pixels.dtype)
        else:
            image, valid = renderer.draw(self.pixels)
            image = np.where(valid[..., None], blur.mend(image, lattice.pitch / patch_size), 0)
        affine = renderer.grid.affine()
        return finish_picture(image, valid, affine, renderer.scale, self.flat, calibration)


def stack_depths(depth: DepthMap, count: int) -> list[float]:
    """Patch sizes [px] for a focal stack through a scene, from far to near; one alone is in the
    middle.

    They are evenly spaced in the virtual depth `D / s`, as is the blur between one and the next.
    ValueError if `count` is below 1, or no lens of the depth map is resolved.

    Examples
    --------
    >>> import lfrender
    >>> len(stack_depths(lfrender.data.example()[2], 5))
    5
    """
    check_type(depth, DepthMap, "depth", DEPTH_ADVICE)
    if count < 1:
        raise ValueError(f"a stack has at least one picture, got {count}")
    resolved = depth.patch_size[np.isfinite(depth.patch_size)]
    if not resolved.size:
        raise ValueError(
            "no lens is resolved, so the depths of a stack are unknown; give patch sizes"
        )
    ratio = virtual_depth(resolved, depth.pitch).astype(float)
    # From far telescopic places to near binocular ones, without the gap about the microlenses: no
    # depth with |D / s| below 4 / 3 is resolved, and no picture is in focus there.
    least = 4 / 3
    far, near = -np.quantile(np.sign(ratio) * least - ratio, [0.02, 0.98])
    steps = np.linspace(far, near, count) if count > 1 else np.array([(far + near) / 2])
    signs = np.where(steps == 0, np.sign(np.median(ratio)), np.sign(steps))
    return [float(depth.pitch / value) for value in steps + signs * least]
