"""Differences of the microimage centres of two calibrations of one camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..camera.calibration import Calibration
from ..runtime.arrays import Floats, Frozen
from ..runtime.errors import CAMERA_ADVICE, CalibrationError, check_type

__all__ = ["REGIONS", "LatticeDifference", "compare", "nine_places", "scale_and_rotation"]

#: Names of corners, edge middles and middle of a flat, in rows from the top.
REGIONS = [
    f"{row} {column}"
    for row in ("top", "middle", "bottom")
    for column in ("left", "centre", "right")
]


@dataclass(frozen=True, eq=False)
class LatticeDifference(Frozen):
    """Centres of calibration B minus those of calibration A, whatever lens each calls the first.

    Parameters
    ----------
    rms, max : float [px]
        Root mean square and largest length of the differences over all microimages on the flat.
    mean_shift : (2,) float64 [px]
        Mean difference, order x, y.
    scale : float
        Pitch of B over pitch of A.
    rotation_degrees : float
        Rotation from A to B, clockwise on the screen.
    positions, field : (3, 3, 2) float64 [px]
        Corners, edge middles and middle of the flat, in rows from the top, and the difference at
        each.

    Examples
    --------
    >>> from lfcal import Calibration, Lattice, compare
    >>> first = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (400, 300), 9))
    >>> second = Calibration(Lattice([10.5, 10], [[20, 0], [0, 20]], (400, 300), 9))
    >>> difference = compare(first, second)
    >>> round(difference.rms, 3)
    0.5
    """

    rms: float
    max: float
    mean_shift: Floats
    scale: float
    rotation_degrees: float
    positions: Floats
    field: Floats


def nine_places(image_size: tuple[int, int]) -> Floats:
    """(3, 3, 2) corners, edge middles and middle of a flat [px], in rows from the top."""
    return np.stack(np.meshgrid(*(np.linspace(0, side - 1, 3) for side in image_size)), axis=-1)


def scale_and_rotation(matrix: Floats) -> tuple[float, float]:
    """Scale of a linear map (2, 2) of row vectors, and its rotation [degrees], clockwise on the
    screen.
    """
    turn = np.arctan2(matrix[0, 1] - matrix[1, 0], np.trace(matrix))
    return float(np.sqrt(abs(np.linalg.det(matrix)))), float(np.degrees(turn))


def compare(a: Calibration, b: Calibration) -> LatticeDifference:
    """Compare the centres of two calibrations over flats of one size.

    The two lattices may have different origins and bases; CalibrationError if a basis vector
    differs by more than a quarter of the pitch. If the pitches differ, differences may exceed half
    a pitch: they belong to the same lens, not to the nearest one.

    Examples
    --------
    >>> from lfcal import Calibration, Lattice
    >>> basis = [[20, 0], [0, 20]]
    >>> a, b = (Calibration(Lattice([x, 30], basis, (200, 100), 9)) for x in (40, 60.5))
    >>> round(compare(a, b).rms, 6)
    0.5
    """
    for name, camera in (("a", a), ("b", b)):
        check_type(camera, Calibration, name, CAMERA_ADVICE)
    if a.image_size != b.image_size:
        sizes = " and ".join("{} x {}".format(*size) for size in (a.image_size, b.image_size))
        raise CalibrationError(
            f"the cameras are for flats of {sizes} px; compare calibrations of flats of one size"
        )
    first = a.lattice
    second = b.lattice
    same = np.rint(first.basis @ np.linalg.inv(second.basis))
    leftover = np.linalg.norm(first.basis - same @ second.basis, axis=1)
    if round(abs(np.linalg.det(same))) != 1 or (leftover > 0.25 * first.pitch).any():
        raise CalibrationError(
            f"the lattices are different ones, with pitches of {first.pitch:.2f} and "
            f"{second.pitch:.2f} px, not one lattice measured twice; look at both with 'lfcal show'"
        )
    centres = first.centres()
    anchor = np.rint(np.median(second.to_index(centres) - first.indices() @ same, axis=0))

    def difference(places: Floats) -> Floats:
        return (first.to_index(places) @ same + anchor - second.to_index(places)) @ second.basis

    offset = difference(centres)
    # A plane through the differences gives scale and rotation.
    design = np.column_stack([np.ones(len(centres)), centres])
    matrix = np.eye(2) + np.linalg.lstsq(design, offset, rcond=None)[0][1:]
    scale, turn = scale_and_rotation(matrix)
    positions = nine_places(a.image_size)
    lengths = np.hypot(*offset.T)
    return LatticeDifference(
        rms=float(np.sqrt(np.mean(lengths**2))),
        max=float(lengths.max()),
        mean_shift=offset.mean(0),
        scale=scale,
        rotation_degrees=turn,
        positions=positions,
        field=difference(positions.reshape(-1, 2)).reshape(3, 3, 2),
    )
