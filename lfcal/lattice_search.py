"""Candidates of the lattice of a camera on its flats, each with its evidence and its final fit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .camera.evidence import Evidence
from .detection.search import Candidate, find_candidates, measure_lattice
from .detection.tones import is_white_image
from .images.mosaic import equalise_mosaic, remove_mosaic
from .images.preprocessing import luminance, sqrt_luminance
from .images.stack import average_scenes, combine_whites, select_contrasted
from .lattice.lattice import Lattice
from .lattice.lens_subset import ReadCrop, StackedCrops
from .lattice.robust_fit import LatticeFit
from .lattice.stated import LatticeHint
from .runtime.errors import RAW_FLAT_ADVICE, CalibrationError

__all__ = ["FittedLattice", "find_lattice", "find_lattice_of_large"]

#: A lattice with this probability ends the search, and least one of a lattice that is returned.
_LIKELY = 0.9
_LEAST = 0.5
#: [pitch] from its candidate, beyond which a fit is not that of the lattice with this evidence.
#: Right fits on the shared flats moved by 0.03 at most.
_FAR = 0.05
#: Places of a very large flat that a lattice is searched for in.
_TRIES = 9
#: Candidates that are fitted, the most probable first.
_MOST_FITTED = 3


@dataclass(frozen=True)
class FittedLattice:
    """A lattice fitted to a picture, with what speaks for it."""

    # (h, w) root of the luminance, or crops of a white image
    picture: NDArray[np.float32] | StackedCrops
    white: bool  # the flat is a white image
    fit: LatticeFit
    evidence: Evidence
    read_crop: ReadCrop | None = None  # reads any part of the flat, where `picture` are crops

    @property
    def probability(self) -> float:
        """Probability that this is the lattice of the microimages."""
        return self.evidence.probability

    @classmethod
    def of(
        cls,
        picture: NDArray[np.float32] | StackedCrops,
        white: bool,
        start: Candidate,
        fit: LatticeFit,
        read_crop: ReadCrop | None = None,
    ) -> FittedLattice:
        """The fit that began at a candidate, with the agreement of its own halves.

        A fit that has moved to where the flat has no evidence for it has run away: a candidate that
        ends the search is kept. For others, the distance counts against both.
        """
        pitch = fit.lattice.pitch
        halves = max(fit.half_difference, fit.displacement) / pitch
        far = fit.displacement > _FAR * pitch and start.evidence.probability > _LIKELY
        if far and isinstance(picture, np.ndarray):
            straight = replace(fit.lattice, distortion=None)
            moved = measure_lattice(picture, straight, start.evidence.stated_white)
            if moved.evidence.probability < 0.5:
                halves = start.evidence.halves
                fit = LatticeFit(
                    start.lattice, fit.residual_rms, fit.lenses_used, start.half_difference
                )
        return cls(picture, white, fit, start.evidence.with_halves(halves), read_crop)


def find_lattice_of_large(
    flat: NDArray[Any], kind: str, has_mosaic: bool, in_crops: bool
) -> FittedLattice | None:
    """The lattice of a large white image, from its middle outwards; None where it is none.

    Of a very large one only crops are fitted.
    """
    from .white_fit.fit import fit_lattice_to_white_image
    from .white_fit.large import find_white_lattice, sample_parts, window_reader

    read = window_reader(flat, has_mosaic)
    size = flat.shape[1], flat.shape[0]
    start = find_white_lattice(read, size, kind == "white", _TRIES if in_crops else 1)
    if start is None:
        return None
    picture: NDArray[np.float32] | StackedCrops
    read_crop = None
    if in_crops:
        picture, read_crop = sample_parts(read, start.lattice)
    else:
        picture = sqrt_luminance(flat)
    fit = fit_lattice_to_white_image(picture, start)
    return FittedLattice.of(picture, True, start, fit, read_crop)


def find_lattice(
    flats: list[NDArray[Any]], kind: str, has_mosaic: bool, hint: LatticeHint | None = None
) -> FittedLattice:
    """The most probable lattice of whole flats (h, w) or (h, w, 3).

    Raises
    ------
    CalibrationError
        If none is more probable than not; the message names the best and what speaks against it.
    """
    lights = [equalise_mosaic(flat) if has_mosaic else luminance(flat) for flat in flats]
    if len(lights) > 1:
        lights = [lights[k] for k in select_contrasted(lights)]
    candidates = _search(lights, has_mosaic, hint, float(kind == "white"))
    fitted: list[FittedLattice] = []
    error: CalibrationError | None = None
    for start in islice(candidates, _MOST_FITTED):
        # A fit tells how precise a lattice is, not that it is one.
        if start.evidence.with_halves(0.0).probability < _LEAST:
            continue
        try:
            fitted.append(_fit(lights, start, kind, has_mosaic))
        except CalibrationError as failure:
            error = error or failure
            continue
        if fitted[-1].probability > _LIKELY:
            break
    if error is not None and not fitted:
        raise error
    best = max(fitted, key=lambda one: one.probability, default=None)
    if best is None:
        raise CalibrationError(
            describe_doubt(candidates, candidates[0].lattice, candidates[0].evidence)
        )
    if best.probability < _LEAST:
        raise CalibrationError(describe_doubt(candidates, best.fit.lattice, best.evidence))
    return best


def describe_doubt(candidates: list[Candidate], lattice: Lattice, evidence: Evidence) -> str:
    """What repeats on a flat, and what speaks against the best lattice on it, and another one."""
    pitch = lattice.pitch
    text = f"a pattern repeats every {pitch:.1f} px, but {evidence.describe_doubt()}"
    others = [one for one in candidates if abs(one.lattice.pitch / pitch - 1) > 0.02]
    if others:
        other = others[0]
        text += (
            f"; of the one every {other.lattice.pitch:.1f} px, {other.evidence.describe_doubt()}"
        )
    return f"{text}; {RAW_FLAT_ADVICE}"


def _search(
    lights: list[NDArray[np.float32]],
    has_mosaic: bool,
    hint: LatticeHint | None,
    stated_white: float,
) -> list[Candidate]:
    """Candidates on the mean of the lights, and on each light if none is certain on the mean."""
    found: list[Candidate] = []
    error: CalibrationError | None = None
    for number, picture in enumerate(_pictures(lights, has_mosaic)):
        again = number > 0
        try:
            found += find_candidates(picture, hint, stated_white=stated_white, again=again)
        except CalibrationError as failure:
            error = error or failure
        if found and max(one.evidence.probability for one in found) > _LIKELY:
            break
    if not found:
        assert error is not None
        raise error
    return sorted(found, key=lambda one: -one.evidence.rank)


def _pictures(lights: list[NDArray[np.float32]], has_mosaic: bool) -> Iterator[NDArray[np.float32]]:
    """Roots of the mean of the lights, softer ones where bright places outweigh the rest, then of
    each; no mosaic.
    """
    mean = average_scenes(lights) if len(lights) > 1 else lights[0]
    for light in [mean, np.sqrt(mean), *(lights if len(lights) > 1 else [])]:
        yield sqrt_luminance(remove_mosaic(light) if has_mosaic else light)


def _fit(
    lights: list[NDArray[np.float32]], start: Candidate, kind: str, has_mosaic: bool
) -> FittedLattice:
    """The final lattice from a candidate: by the white images among the lights, or else by all as
    scenes.
    """
    whites = _select_whites(lights, start, kind, has_mosaic)
    if whites:
        from .white_fit.fit import fit_lattice_to_white_image

        picture = sqrt_luminance(combine_whites(whites) if len(whites) > 1 else whites[0])
        try:
            return FittedLattice.of(
                picture, True, start, fit_lattice_to_white_image(picture, start)
            )
        except CalibrationError:
            if kind == "white":
                raise
    from .scene_fit.fit import fit_lattice_to_scenes

    scenes = [remove_mosaic(light) for light in lights] if has_mosaic else lights
    picture = sqrt_luminance(average_scenes(scenes) if len(scenes) > 1 else scenes[0])
    try:
        fit = fit_lattice_to_scenes(scenes, picture, start)
    except np.linalg.LinAlgError as failure:
        # The lattice is not determined in one of the directions.
        text = f"what repeats on the image has no edges to place microimages by; {RAW_FLAT_ADVICE}"
        raise CalibrationError(text) from failure
    return FittedLattice.of(picture, False, start, fit)


def _select_whites(
    lights: list[NDArray[np.float32]], start: Candidate, kind: str, has_mosaic: bool
) -> list[NDArray[np.float32]]:
    """The lights (h, w) that are white images; all or none where their kind is stated."""
    if kind != "auto":
        return lights if kind == "white" else []
    if len(lights) == 1:
        return lights if start.evidence.white_probability > 0.5 else []
    pictures = [sqrt_luminance(light) for light in lights]
    return [
        light
        for light, picture in zip(lights, pictures, strict=True)
        if is_white_image(picture, start.lattice)
    ]
