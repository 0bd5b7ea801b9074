"""Final lattice of a camera: by every pixel of a white image, or by the edges between the
microimages of scenes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .lattice.lattice import Lattice
from .lattice.robust_fit import LatticeFit, field_rms, fit_affine
from .lattice.standard_errors import equal_weight_errors
from .runtime.errors import CalibrationError

if TYPE_CHECKING:
    from .detection.search import Candidate
    from .lattice.lens_subset import StackedCrops

__all__ = ["fit_lattice_to_scenes", "fit_lattice_to_white_image"]

# [px] in a lens from which on its light is measured well enough to compare, and its edge can be
# fitted.
_FEWEST_PIXELS = 20.0


def fit_lattice_to_white_image(
    picture: NDArray[np.float32] | StackedCrops, start: Candidate
) -> LatticeFit:
    """Fit a white image (h, w), as made by `sqrt_luminance`, or crops of it; keep `start` where the
    fit runs away.
    """
    from .images.preprocessing import soften_mask
    from .lattice.lens_subset import StackedCrops
    from .white_fit.fit import fit_white

    found = start.lattice
    if isinstance(picture, np.ndarray) and _count_lit_pixels(picture, found) < _FEWEST_PIXELS:
        return _fit_spots(picture, found)
    try:
        white = fit_white(
            soften_mask(picture) if isinstance(picture, np.ndarray) else picture, found
        )
    except CalibrationError:
        raise
    except ValueError as error:
        # A distortion that no lattice can have.
        raise CalibrationError(
            "the microimages do not keep to one lattice; give a white image with more of them or "
            "with less noise"
        ) from error
    crops = StackedCrops.of(picture)
    index = found.indices() if crops.size == found.image_size else crops.lenses(found, 0.0)[0]
    places = found.points(index[:: max(1, len(index) // 4000)])
    # A distortion that the start does not have is no error of it.
    near = (
        white.lattice if found.distortion is not None else replace(white.lattice, distortion=None)
    )
    distance = near.points(np.rint(near.to_index(places))) - places
    # A fit that has run away.
    if not np.sqrt((distance**2).sum(1).mean()) < 0.2 * found.pitch:
        return LatticeFit(found, white.residual_rms, white.lenses_used, start.half_difference)
    return replace(white, displacement=_displacement(white, places))


def _count_lit_pixels(picture: NDArray[np.float32], lattice: Lattice) -> float:
    """Pixels of a disc of even light with the mean and variance of the light in a cell; `picture`
    is its root.
    """
    light = picture.astype(np.float64) ** 2
    return float(abs(np.linalg.det(lattice.basis)) * light.mean() ** 2 / np.mean(light**2))


def _fit_spots(picture: NDArray[np.float32], start: Lattice) -> LatticeFit:
    """Fit a lattice to the centroids of the light of spots of few pixels, as unfocused cameras make
    with a small pupil.

    So few pixels have no edge that a profile could follow, and the root of their light, `picture`
    (h, w), has its centre elsewhere. In each of three passes, windows as wide as cells are put
    about the fitted centres.
    """
    lattice = start
    reach = int(np.hypot(*(start.steps @ start.basis).T).min() / 2)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    inside = np.hypot(x, y) <= reach
    x = x[inside]
    y = y[inside]
    for _ in range(3):
        indices, centres = lattice.select_whole(reach + 1)
        corner = np.rint(centres).astype(np.int64)
        light = picture[corner[:, 1, None] + y, corner[:, 0, None] + x].astype(np.float64) ** 2
        light -= np.median(light, axis=1, keepdims=True)
        np.maximum(light, 0, out=light)
        total = light.sum(1)
        lit = total > 0.1 * np.quantile(total, 0.9)
        if lit.sum() < 12:
            raise CalibrationError(
                f"only {lit.sum()} whole microimages have light; give a brighter white image"
            )
        indices, centres, corner, light, total = (
            v[lit] for v in (indices, centres, corner, light, total)
        )
        shifts = corner + np.column_stack([light @ x, light @ y]) / total[:, None] - centres
        design = np.column_stack([np.ones(len(indices)), indices])
        change, weight = fit_affine(design, shifts, np.ones(len(indices)))
        lattice = Lattice(
            lattice.origin + change[0], lattice.basis + change[1:], start.image_size, start.radius
        )
    first, second = (
        fit_affine(design[k::2], shifts[k::2], np.ones(len(shifts[k::2])))[0] for k in (0, 1)
    )
    scatter = float(np.sqrt(np.average(((shifts - design @ change) ** 2).sum(1), weights=weight)))
    used = int((weight > 0).sum())
    # Three parameters of each coordinate, from so many lenses.
    uncertainty = scatter * np.sqrt(3 / used)
    differ = field_rms(design, first - second)
    return LatticeFit(lattice, scatter, used, differ, equal_weight_errors(lattice, uncertainty))


def _displacement(white: LatticeFit, places: NDArray[np.float64]) -> float:
    """`LatticeFit.displacement` of a fit at `places` (n, 2) [px], centres on the first lattice.

    The first lattice is straight and goes through the middles of the visible microimages; those of
    cut ones lie off the centre by up to half of the cut.
    """
    lattice = white.lattice
    centres = lattice.points(np.rint(lattice.to_index(places)))
    cut = np.zeros(places.shape)
    if white.cut is not None:
        cut = white.cut[:2] + white.cut[2] * lattice.field_place(centres)
    middle = places - places.mean(0)
    base = np.linalg.qr(np.column_stack([np.ones(len(places)), middle / np.abs(middle).max()]))[0]
    distance = base.T @ (centres - places)
    cut = base.T @ cut
    # Of two equal discs, the middle shifts by half of the cut.
    share = np.clip(-(distance * cut).sum() / max(float((cut**2).sum()), 1e-300), 0, 0.5)
    return float(np.sqrt(((distance + share * cut) ** 2).sum() / len(places)))


def fit_lattice_to_scenes(
    lights: list[NDArray[np.float32]], picture: NDArray[np.float32], start: Candidate
) -> LatticeFit:
    """Fit one or several scenes of luminance `lights` (h, w); `picture` is the root of their mean.

    Only the edges at the rims are those of the lattice: brightness also shows the scene, gaps of
    cut microimages, and where a camera has flattened its pictures with another white image.
    """
    from .images.preprocessing import edge_strength, normalise_locally, sqrt_luminance
    from .scene_fit.fit import fit_scene

    found = start.lattice
    # More than a rim, less than the scene in a lens.
    window = 0.5 * found.pitch
    rims = normalise_locally(
        edge_strength(picture if len(lights) == 1 else sqrt_luminance(lights[0])), window
    )
    for light in lights[1:]:
        rims += normalise_locally(edge_strength(sqrt_luminance(light)), window)
    if len(lights) > 1:
        rims /= np.float32(len(lights))
    fit = fit_scene(rims, found)
    if fit.residual_rms > 0.02 * found.pitch and not fit.half_difference < start.half_difference:
        # Single lenses scatter too much: averages of whole tiles are the better measure.
        return LatticeFit(found, fit.residual_rms, fit.lenses_used, start.half_difference)
    return fit
