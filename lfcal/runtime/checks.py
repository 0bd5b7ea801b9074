"""Where a result is doubtful: each figure that tells it, its one limit, and the sentence that users get.

All commands, `--json` included, and all functions take limits and sentences from here. A doubtful result is a warning;
a refuted one is an error where it is found, with exit code 2. What decides neither stands in the settings of its room.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "LIMITS", "Limits", "find_board_doubt", "find_camera_doubt", "find_centroid_doubt", "find_circle_doubt",
    "find_depth_doubt", "find_exposure_doubt", "find_gain_doubt", "find_lattice_doubt", "find_mosaic_doubt",
    "find_type_doubt",
]  # fmt: skip


@dataclass(frozen=True)
class Limits:
    """From where on a result is doubtful."""

    confidence: float = 0.7  # of a calibration, below it
    centroids: float = 0.2  # [px] of whole microimages beside a fitted lattice
    off_gain: float = 0.03  # share of the pixels of a white image that differ from the gain map: 25 white images have
    # up to 0.027 (a binary mask), one with large specks of dust 0.05, a checkerboard seen through an array 0.12
    clipped: float = 0.02  # share of the pixels of a white image
    circles_beside: float = 0.3  # agreement of circles beside the lattice over that on it
    shift: float = 0.06  # [pitch] of a flat beside its camera: at most 0.05 with right cameras on 60 simulated flats
    # [pitch] of a corner by a change of scale or rotation: right cameras are up to 0.028 off on 11 captures, another
    # one of the same kind is 0.039 off.
    stretch: float = 0.033
    on_surface: float = 0.02  # share of the lenses: a scene that is one small card has 0.04, an unfocused one 0.001
    by_chance: float = 0.5  # share of the resolved lenses that lie on surfaces: captures have 0.7 to 1, chance 0 to 0.1
    board_noise: float = 6.0  # misfit of the corners of boards over the noise of their pixels


LIMITS = Limits()


def find_lattice_doubt(confidence: float, differ: float) -> str | None:
    """`differ` [px] is the RMS distance of the lattices of two halves of the flat."""
    return None if confidence >= LIMITS.confidence else (
        f"the lattice is uncertain (confidence {confidence:.2f}, halves of the flat differ by {differ:.2f} px); "
        "check the circles on the flat or calibrate on a white image"
    )  # fmt: skip


def find_circle_doubt(on: float, beside: float) -> str | None:
    """Agreement of circles found by Hough vote with the lattice, and with places between its centres."""
    return None if not beside > on + LIMITS.circles_beside else (
        f"circles on the flat lie between the centres of the lattice (agreement {beside:.2f} there, {on:.2f} on it): "
        "gaps may have been taken for microimages; check the circles on the flat ('lfcal show')"
    )  # fmt: skip


def find_centroid_doubt(offset: float) -> str | None:
    """Distance [px] of plain centroids of whole microimages in the middle of a white image from the lattice."""
    return None if not offset > LIMITS.centroids else (
        f"plain centroids of the microimages in the middle lie {offset:.2f} px beside the lattice, which follows their "
        "edges: the light in them is uneven or reaches into the gaps; if the circles lie off the microimages ('lfcal "
        "show'), light the white image evenly"
    )  # fmt: skip


def find_gain_doubt(share: float) -> str | None:
    """`share` of the pixels of a white image that differ from its gain map."""
    return None if not share > LIMITS.off_gain else (
        f"{share:.1%} of the pixels differ from the gain map, more than defects explain; check the white image for "
        "structure or saturation"
    )  # fmt: skip


def find_exposure_doubt(clipped: float) -> str | None:
    """`clipped` share of the pixels of a white image."""
    return None if not clipped > LIMITS.clipped else (
        f"the white image is over-exposed ({clipped:.0%} of its pixels are clipped): expose less, by a half or more"
    )  # fmt: skip


def find_type_doubt(count: int, ordered: bool) -> str | None:
    """Types of lenses, and whether it is known which is focused at which depth."""
    return None if ordered else (
        f"{count} lens types were found, but not which is focused at which depth; "
        "calibrate on a scene with detail at several depths"
    )  # fmt: skip


def find_mosaic_doubt(guessed: str | None) -> str | None:
    """Colour filters that were found on a flat."""
    return None if guessed is None else (
        f"the flat is seen through colour filters, taken for {guessed}: where green is was measured, red and blue are "
        "a guess; if they look exchanged, name the filters (--mosaic RGGB, BGGR, GRBG or GBRG)"
    )  # fmt: skip


def find_camera_doubt(offset: float, shift: float, stretch: float, where: str) -> str | None:
    """Largest `offset` [px] of a flat from its camera, at `where`; shift and stretch in pitches."""
    return None if not (stretch > LIMITS.stretch or shift > LIMITS.shift) else (
        f"the lattice is off by up to {offset:.1f} px in the {where}, which pictures show: calibrate on this flat"
    )  # fmt: skip


def find_depth_doubt(missing: float, resolved: float, on_surface: float) -> str | None:
    """Shares of the lenses that have no depth, have one, and lie on a surface with others."""
    return None if not on_surface < max(LIMITS.on_surface, LIMITS.by_chance * resolved) else (
        f"{missing:.0%} of the lenses have no depth, and the others form no surface; is this a capture of a scene, and "
        "made with this camera?"
    )  # fmt: skip


def find_board_doubt(noise: float) -> str | None:
    """Misfit of the corners of boards, over the noise of their pixels."""
    return None if not noise > LIMITS.board_noise else (
        f"corners lie {noise:.0f} times as far from the model as their noise explains; is the board flat, "
        "are squares and pixel right, was nothing moved?"
    )  # fmt: skip
