"""Final lattice of a camera: every pixel of a white image, or the edge_strength between microimages of scenes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .lattice.lattice import Lattice
from .lattice.residuals import Residuals
from .lattice.standard_errors import LatticeErrors, equal_weight_errors
from .runtime.errors import CalibrationError

if TYPE_CHECKING:
    from .detection.first_lattice import FirstLattice
    from .lattice.lens_subset import StackedCrops
    from .white_fit.fit import WhiteFit
    from .white_fit.model import CatEye

__all__ = ["FinalLattice", "fit_lattice_to_scenes", "fit_lattice_to_white_image"]

# Window, in pitches, in which edges are levelled: wider than a rim, narrower than what the scene shows in a lens.
_RIM = 0.5
# A fit that leaves the first lattice by more than this share of the pitch (RMS) has followed something else.
_FOLLOWED = 0.2
# Lenses that scatter by more than this share of the pitch have rims too faint to be placed by them one at a time.
_FAINT = 0.02
# Part of the cut by which the middle of two discs of one size lies off the centre of the first.
_SEEN_OFF = 0.5
# So many lenses tell whether it has.
_TELLING = 4000


@dataclass(frozen=True)
class FinalLattice:
    """The lattice and how its microimages agree with it.

    Parameters
    ----------
    lattice : Lattice [px]
    residual_rms : float [px]
        Robust RMS distance of single microimages from the lattice.
    lenses_used : int
    half_difference : float [px]
        RMS distance over the flat between lattices of two independent halves of the microimages.
    errors : LatticeErrors or None
        None where the lattice is the first one.
    cat_eye : CatEye or None
        The disc that cuts microimages, where one was seen.
    residuals : Residuals or None
        Of single microimages; None where these are too unlike one another to be placed singly.
    strays : float [px]
        RMS distance over the flat from the first lattice, beyond what distortion and cut microimages make of it.
    """

    lattice: Lattice
    residual_rms: float
    lenses_used: int
    half_difference: float
    errors: LatticeErrors | None = None
    cat_eye: CatEye | None = None
    residuals: Residuals | None = None
    displacement: float = 0.0


def fit_lattice_to_white_image(picture: NDArray[np.float32] | StackedCrops, start: FirstLattice) -> FinalLattice:
    """Fit the `sqrt_luminance` picture of a white image, or parts of it."""
    from .lattice.lens_subset import StackedCrops
    from .white_fit.fit import fit_white

    found = start.lattice
    try:
        discs = fit_white(picture, found)
    except CalibrationError:
        raise
    except ValueError as error:
        # A distortion that no lattice can have.
        raise CalibrationError(
            "the microimages do not keep to one lattice; give a white image with more of them or with less noise"
        ) from error
    parts = StackedCrops.of(picture)
    index = found.indices() if parts.size == found.image_size else parts.lenses(found, 0.0)[0]
    index = index[:: max(1, len(index) // _TELLING)]
    # What the distortion moves counts only where the start knew of it.
    near = discs.lattice if found.distortion is not None else replace(discs.lattice, distortion=None)
    apart = near.points(np.rint(near.to_index(found.points(index)))) - found.points(index)
    if not np.sqrt((apart**2).sum(1).mean()) < _FOLLOWED * found.pitch:
        return FinalLattice(found, discs.residual_rms, discs.lenses_used, start.half_difference)
    return FinalLattice(
        discs.lattice,
        discs.residual_rms,
        discs.lenses_used,
        discs.half_difference,
        discs.errors,
        discs.cat_eye,
        discs.residuals,
        _strays(found, discs, found.points(index)),
    )


def _strays(found: Lattice, discs: WhiteFit, places: NDArray[np.float64]) -> float:
    """`FinalLattice.displacement` of a fit at `places` (n, 2) [px], centres on the first lattice.

    That is the straight lattice through what is seen of the microimages: of cut ones the middle lies off the centre by
    up to half of the cut.
    """
    from .white_fit.model import field_position

    lattice = discs.lattice
    centres = lattice.points(np.rint(lattice.to_index(places)))
    field, eye = field_position(centres, lattice), discs.cat_eye
    cut = np.zeros(places.shape) if eye is None else eye.displacement(field)
    middle = places - places.mean(0)
    base = np.linalg.qr(np.column_stack([np.ones(len(places)), middle / np.abs(middle).max()]))[0]
    apart, cut = base.T @ (centres - places), base.T @ cut
    part = np.clip(-(apart * cut).sum() / max(float((cut**2).sum()), 1e-300), 0, _SEEN_OFF)
    return float(np.sqrt(((apart + part * cut) ** 2).sum() / len(places)))


def fit_lattice_to_scenes(
    lights: list[NDArray[np.float32]], picture: NDArray[np.float32], start: FirstLattice
) -> FinalLattice:
    """Fit the lights (h, w) of one or several scenes; `picture` is the `sqrt_luminance` of their mean.

    Only the edge_strength at the rims are what the lattice predicts: brightness also shows the scene, gaps that cut
    microimages have moved, and where a camera has flattened its pictures with another white image.
    """
    from .images.preprocessing import edge_strength, normalise_locally, sqrt_luminance
    from .scene_fit.fit import fit_scene

    found = start.lattice
    rims = normalise_locally(
        edge_strength(picture if len(lights) == 1 else sqrt_luminance(lights[0])), _RIM * found.pitch
    )
    for light in lights[1:]:
        rims += normalise_locally(edge_strength(sqrt_luminance(light)), _RIM * found.pitch)
    if len(lights) > 1:
        rims /= np.float32(len(lights))
    fit = fit_scene(rims, found)
    if fit.residual_rms > _FAINT * found.pitch and not fit.half_difference < start.half_difference:
        # Rims too faint for single lenses: what whole tiles have in common is the better measure.
        return FinalLattice(found, fit.residual_rms, fit.lenses_used, start.half_difference)
    lattice = Lattice(fit.origin, fit.basis, found.image_size, found.radius, fit.distortion)
    errors = equal_weight_errors(lattice, fit.uncertainty)
    return FinalLattice(lattice, fit.residual_rms, fit.lenses_used, fit.half_difference, errors)
