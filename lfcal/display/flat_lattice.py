"""Measure where the microimages of a flat lie against those of a camera: the one answer that all
checks of a camera put into words.

Strong evidence of its lattice in the middle of the flat confirms a camera in about a tenth of a
second, if a few hundred lenses of the whole flat agree. Else the evidence is measured on the whole
flat, as `calibrate` measures that of candidates. A camera whose lattice has
enough evidence is compared with the fit that begins there. Only if the flat has no evidence for it,
another place of this lattice, or another lattice, is looked for. Flats are downscaled to
microimages of 10 to 20 pixels.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from ..camera.calibration import Calibration
from ..lattice.cell import nearest_offsets
from ..lattice.lattice import Lattice
from ..runtime.arrays import ENOUGH_LENSES, Array, Singles, evenly
from ..runtime.errors import CAMERA_ADVICE, CalibrationError, FlatError, check_type
from .misfit import MOST_SHIFT, MOST_STRETCH, Misfit

if TYPE_CHECKING:
    from ..detection.search import Candidate

__all__ = ["SeenLattice", "confirm_by_middle", "measure_camera"]

# Least probability of a lattice that a camera is compared with.
_LIKELY = 0.5
# Least probability of a lattice, found at the basis of the camera, that may confirm the camera.
_LIKELY_AT_BASIS = 0.05
# Offset of a corner [pitch] up to which centres of two lattices can be paired.
_NEIGHBOUR = 0.4
# Lenses that are fitted: with 8,000, offsets on eight captures differ by less than 0.004 pitch, or
# by 0.02 where the camera is wrong.
_CHECKED_LENSES = 1400
# Lenses that are fitted, pitches along the part of a flat that is measured, and its least
# probability, where a camera may be confirmed without the rest of the flat. With more of each it
# takes longer. Right cameras had 0.97 and more on 38 simulated flats, at most 0.01 half a pitch
# beside.
_FEW_LENSES = 250
_PART = 16
_CERTAIN = 0.9
# Largest difference of the lattices of two halves of the microimages [pitch]: fits that differ by
# more do not tell whether corners are off.
_HALVES = MOST_STRETCH
# Errors that a fit may have in a corner, in standard errors of the middle: 2.4 times that, six of
# them are chance (`SIGNIFICANT`), and lenses beside each other share half of their error. Beads in
# the dark have corners 27 off, wrong cameras 49 and more.
_CORNER_ERRORS = 30
# Pitches [px] and pixels of downscaled flats: larger ones take time and show no more.
_PITCH = 18
_LEAST_PITCH = 10
_PIXELS = 4e6


class ReducedFlat(NamedTuple):
    """A flat, and a downscaled picture of it."""

    flat: Array  # without its mosaic
    factor: int  # side of the blocks of pixels that are averaged
    picture: Singles  # root of the luminance of the downscaled flat


def prepare_flat(calibration: Calibration, image: ArrayLike) -> ReducedFlat:
    """Check the arguments, remove the mosaic of the flat and downscale it."""
    from ..images.mosaic import equalise_mosaic, find_mosaic, remove_mosaic

    check_type(calibration, Calibration, "calibration", CAMERA_ADVICE)
    flat = np.asarray(image)
    width, height = calibration.image_size
    if flat.ndim not in (2, 3) or flat.shape[:2] != (height, width):
        raise FlatError(
            f"image has shape {flat.shape}; the camera is for flats of {width} x {height} px, give "
            "one of its size"
        )
    if flat.ndim == 2 and (calibration.mosaic or find_mosaic(flat)):
        flat = remove_mosaic(equalise_mosaic(flat))
    pitch = calibration.lattice.pitch
    large = int(np.ceil(np.sqrt(width * height / _PIXELS)))
    factor = max(1, int(pitch / _PITCH), min(int(pitch / _LEAST_PITCH), large))
    return ReducedFlat(flat, factor, reduce_flat(flat, factor))


def reduce_flat(flat: Array, factor: int) -> Singles:
    """Root of the luminance (h, w) of a flat, averaged over `factor` x `factor` pixels."""
    from ..images.preprocessing import sqrt_luminance

    if factor > 1:
        import cv2

        height, width = (length // factor for length in flat.shape[:2])
        flat = flat[: factor * height, : factor * width]
        if flat.dtype not in (np.uint8, np.uint16, np.float32):
            flat = flat.astype(np.float32)
        flat = np.asarray(cv2.resize(flat, (width, height), interpolation=cv2.INTER_AREA))
    return sqrt_luminance(flat)


class SeenLattice(NamedTuple):
    """What a flat shows of the lattice of a camera."""

    flat: Array  # without its mosaic
    lattice: Lattice | None = None  # [px] what the flat shows, None if there is none to be seen
    misfit: Misfit | None = None  # offset from the camera, None if the cells are others
    measured: bool = False  # the misfit is that of a fit, not only that of two lattices


# The equations are too small for more threads to pay off: they double the processor time.
@threadpool_limits.wrap(limits=1, user_api="blas")
def measure_camera(calibration: Calibration, image: ArrayLike) -> SeenLattice:
    """Measure the lattice of a flat against that of a camera.

    `image` (h, w) or (h, w, 3) is a white image or any scene capture. FlatError if it has another
    size.
    """
    reduced = prepare_flat(calibration, image)
    given = calibration.lattice
    small = given.downscaled(reduced.factor)
    misfit = confirm_by_middle(reduced.picture, small)
    if misfit is not None:
        return SeenLattice(reduced.flat, given, misfit.upscaled(given), True)
    found = _compare(reduced.picture, small)
    if found is None and reduced.factor > 1:
        # Microimages that are much smaller than those of the camera vanish by downscaling.
        reduced = ReducedFlat(reduced.flat, 1, reduce_flat(reduced.flat, 1))
        small = given
        found = _compare(reduced.picture, small)
    if found is None:
        return SeenLattice(reduced.flat)
    shown = found.scaled(reduced.factor, given.image_size)
    misfit = Misfit.between(_straighten(small), found)
    if misfit is None:
        return SeenLattice(reduced.flat, shown)
    start = small if misfit.is_small else misfit.applied(small)
    fitted = None
    # Beyond, centres are nearest to those of other microimages.
    if misfit.stretch < _NEIGHBOUR:
        fitted = _fit(reduced.picture, small, start)
    if fitted is not None and fitted.differs(misfit):
        fitted = None
    if fitted is not None and calibration.gain_map is not None and misfit.is_small:
        fitted = _without_vignetting(calibration, fitted, reduced.factor)
    best = fitted or misfit
    return SeenLattice(reduced.flat, shown, best.upscaled(given), fitted is not None)


def confirm_by_middle(picture: Singles, given: Lattice) -> Misfit | None:
    """The offset of the microimages from a lattice that is certainly theirs; None if that is open.

    There is strong evidence for it in the middle of the picture, the average cell there is round
    about its points, and the fit to a few lenses of the whole picture does not move it.
    """
    from ..detection.borders import fit_touching_cells
    from ..detection.cell_centre import find_round_centres
    from ..detection.search import TOUCHING, measure_lattice

    straight = _straighten(given)
    side = int(_PART * given.pitch)
    left, top = (max(length - side, 0) // 2 for length in picture.shape[::-1])
    part = np.ascontiguousarray(picture[top : top + side, left : left + side])
    origin = straight.points(straight.middle[None])[0] - (left, top)
    size = part.shape[1], part.shape[0]
    with suppress(CalibrationError, np.linalg.LinAlgError):
        seen = measure_lattice(part, Lattice(origin, straight.basis, size, straight.radius))
        maps = seen.maps
        if seen.evidence.probability < _CERTAIN:
            return None
        if seen.evidence.borders > TOUCHING:
            place = fit_touching_cells(seen.features.steps, straight.basis).origin
        else:
            centre = find_round_centres([maps.brightness, maps.edges], maps.basis)[0]
            place = centre @ straight.basis
        index = straight.to_index(place[None] + (left, top))
        beside = nearest_offsets(index, straight.basis)
        if np.linalg.norm(beside) > MOST_SHIFT / 2 * given.pitch:
            return None
        fitted = _fit(picture, given, given, _FEW_LENSES)
        if fitted is not None and fitted.is_negligible:
            return fitted
    return None


def _straighten(given: Lattice) -> Lattice:
    """The lattice without its distortion."""
    if given.distortion is None:
        return given
    index = given.indices()[evenly(len(given), ENOUGH_LENSES)]
    design = np.column_stack([np.ones(len(index)), index])
    line: Array = np.linalg.lstsq(design, given.points(index), rcond=None)[0]
    return Lattice(line[0], line[1:], given.image_size, given.radius)


def _compare(picture: Singles, given: Lattice) -> Lattice | None:
    """The lattice of a picture: the given one, or one with its basis, unless there is more evidence
    for any other; None if there is none.
    """
    from ..detection.search import find_candidates, measure_basis, measure_lattice

    straight = _straighten(given)
    seen: list[Candidate] = []
    with suppress(CalibrationError, np.linalg.LinAlgError):
        seen = [measure_lattice(picture, straight), *measure_basis(picture, straight)[:1]]
    best = _choose(seen)
    misfit = None if best is None else Misfit.between(straight, best.lattice)
    if best is None or misfit is None or not misfit.is_straight:
        with suppress(CalibrationError, np.linalg.LinAlgError):
            best = _choose([*seen, *find_candidates(picture)[:3]])
    if best is not None:
        return best.lattice
    # A faint lattice may confirm the camera; it is too uncertain to refute it.
    for near in seen[1:]:
        misfit = Misfit.between(straight, near.lattice)
        faint = near.evidence.probability > _LIKELY_AT_BASIS
        if faint and misfit is not None and misfit.is_small:
            return straight
    return None


def _choose(candidates: list[Candidate]) -> Candidate | None:
    """The most probable of likely candidates, of equal ones that of the highest rank."""
    likely = [one for one in candidates if one.evidence.probability > _LIKELY]
    return max(
        likely,
        key=lambda one: (round(one.evidence.probability, 2), one.evidence.rank),
        default=None,
    )


def _fit(
    picture: Singles, given: Lattice, start: Lattice, most: int = _CHECKED_LENSES
) -> Misfit | None:
    """The offset of the lattice of a picture from the given one, by a fit to the edges between at
    most so many microimages; None if that is unsure.
    """
    from ..images.preprocessing import edge_strength, normalise_locally
    from ..scene_fit.fit import fit_scene

    rims = normalise_locally(edge_strength(picture), 0.5 * given.pitch)
    try:
        fit = fit_scene(rims, start, most)
    except (CalibrationError, np.linalg.LinAlgError):
        return None
    if not fit.half_difference < _HALVES * given.pitch:
        return None
    found = fit.lattice
    index = given.indices()[evenly(len(given), ENOUGH_LENSES)]
    centres = given.points(index)
    # Lenses are counted from the middle one, so that all offsets point to the same side.
    own = found.to_index(centres)
    first = found.to_index(given.points(given.middle[None]))
    away = found.points(np.rint(first) + np.rint(own - first)) - centres
    # A linear map is fitted: a single flat does not separate distortion from scene content.
    middle = (np.array(given.image_size) - 1) / 2
    design = np.column_stack([np.ones(len(centres)), centres - middle])
    change: Array = np.linalg.lstsq(design, away, rcond=None)[0]
    scatter = fit.residual_rms / np.sqrt(fit.lenses_used) / given.pitch
    error = float(_CORNER_ERRORS * scatter)
    return Misfit(change[0], change[1:], given.image_size, given.pitch, error)


def _without_vignetting(calibration: Calibration, fitted: Misfit, factor: int) -> Misfit:
    """The offset without that of rims that mechanical vignetting moves: the gain map shows it."""
    from ..gain.rows import RegionGain

    gain = calibration.gain_map
    lattice = calibration.lattice
    if gain is None or len(gain.cut) == 0:
        return fitted
    light = np.nan_to_num(RegionGain(gain, lattice).at(0, 0, *lattice.image_size))
    small = lattice.downscaled(factor)
    rims = _fit(reduce_flat(light, factor), small, small)
    if rims is None:
        return fitted
    return fitted._replace(shift=fitted.shift - rims.shift, linear=fitted.linear - rims.linear)
