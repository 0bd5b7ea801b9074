"""Reconstruct the volume that a light-field microscope has seen, from one raw flat."""

from __future__ import annotations

import numpy as np

from lfcal import Calibration
from lfcal.runtime.arrays import Array, Floats, Singles
from lfcal.runtime.errors import check_type
from lfcal.runtime.progress import Progress, show_progress

from ..depth.region import check_region
from ..flat.validation import check_flat, verify_camera
from ..runtime.types import Region
from .footprint import blur_planes
from .grid import VoxelGrid
from .microscope import Microscope, Scale
from .noise import measure_variance
from .pixels import choose_pixels
from .richardson_lucy import deconvolve
from .volume import Volume

__all__ = ["reconstruct_volume"]

# Slope k, in pitches, up to which volumes reach where no range is given. A pixel averages over a
# pitch there.
_DEFAULT_REACH = 1.0
# Warn that the specimen reaches beyond the range if an outermost plane has this many times the
# light of the median plane. Captures have 1.0 to 1.3 if it ends within the range, 2.0 and more if
# it does not.
_MUCH_LIGHT = 1.5


def reconstruct_volume(
    flat: Array,
    calibration: Calibration,
    microscope: Microscope | None = None,
    *,
    depth_range: tuple[float, float] | None = None,
    planes: int = 41,
    steps: int = 40,
    voxels: int = 8,
    roi: Region | None = None,
    start: Volume | None = None,
    check: bool = True,
    progress: Progress = None,
) -> Volume:
    """Deconvolve a flat of a light-field microscope into a volume (experimental).

    The flat is the sum of what its pixels see of all planes; its pixels are used as they are, on a
    lattice of any pitch and rotation. Light-field deconvolution is from Broxton et al. 2013, with
    rays instead of waves; docs/volumes.md says what it can resolve.

    Parameters
    ----------
    flat : (H, W) or (H, W, C) array
        In proportion to light, the dark frame subtracted; of colours, the mean is taken.
    calibration : Calibration
        With the light of microimages, best from a white image.
    microscope : Microscope, optional
        Optics. Without them, depth is the slope `k = -D / s`, and rays are paraxial.
    depth_range : (float, float), optional
        First and last plane, from the native plane, positive towards the objective: [um], or as
        slopes k. By default as far to both sides as a pixel averages over less than a pitch.
    planes : int
    steps : int
        At most; fewer where the residual comes down to the noise of the flat, or hardly falls any
        more.
    voxels : int
        Along each side of a microlens.
    roi : (x0, y0, x1, y1), optional
        Only the voxels over this part of the flat [px], on the grid of the whole. Lenses around it
        that see them are used too.
    start : Volume, optional
        Of the frame before, on the same grid: fewer steps are needed.
    check : bool
        As in `analyze`; not done with `start`.
    progress : bool or callable, optional
        True shows a bar; a function is called with the numbers of finished and of all steps.

    Returns
    -------
    Volume

    Raises
    ------
    ValueError
        An argument is out of range, or all planes lie where nothing is resolved.
    FlatError, CalibrationError, CameraError
        As for `analyze`.

    Examples
    --------
    >>> import numpy as np, lfrender
    >>> from lfcal import Calibration, Lattice
    >>> camera = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (100, 80), 9))
    >>> flat = np.full((80, 100), 0.5, np.float32)
    >>> lfrender.reconstruct_volume(flat, camera, depth_range=(-4, 4), planes=3, steps=2).fit.steps
    2
    """
    pixels = check_flat(flat, calibration)
    for name, value, least in (("planes", planes, 2), ("steps", steps, 1), ("voxels", voxels, 2)):
        if int(value) != value or value < least:
            raise ValueError(f"{name} must be a whole number of at least {least}, got {value}")
    if check and start is None:
        verify_camera(pixels, calibration)
    optics = microscope or Microscope()
    check_type(optics, Microscope, "microscope", "lfrender.volume.microscope.Microscope is one")
    lattice = calibration.lattice
    scale = optics.scale(_rim_radius(calibration), lattice.pitch)
    grey = _to_light(pixels, calibration)
    used = choose_pixels(grey, calibration, scale.flat_radius, scale.pupil_radius)
    if not used.values.any():
        raise ValueError("flat is dark: no pixel within a microimage has a value above 0")
    depths = _depths(depth_range, planes, scale, lattice.pitch, used.reach)
    slopes = depths * scale.slope_per_depth
    if roi is not None:
        roi = check_region(roi, lattice)
    grid = VoxelGrid.over(lattice, slopes, voxels, used.reach, roi)
    if roi is not None:
        used = grid.select(used)
        if not used.values.any():
            raise ValueError("roi is dark: no pixel within its microimages has a value above 0")
    x, y = (grid.first * scale.pixel).tolist()
    origin = (float(depths[0]), y, x)
    if start is not None:
        check_type(start, Volume, "start", "reconstruct_volume makes one")
        places = ((start.slopes, slopes), (start.origin, origin))
        if start.data.shape != grid.shape or not all(np.allclose(*pair) for pair in places):
            raise ValueError(
                "start must be a volume on the same grid: of the same camera, depth_range, planes, "
                "voxels and roi"
            )
    projector = grid.projector(used, lattice, scale)
    before = None if start is None else grid.pad(start.data)
    variance = measure_variance(grey, calibration)
    with show_progress(progress, "volume") as step:
        found, fit = deconvolve(projector, used, variance, steps, before, step)
    blur_planes(found, grid.null_space(used, lattice))
    data = grid.crop(found)
    spacing = grid.spacing * scale.pixel
    return Volume(
        data,
        (float(depths[1] - depths[0]), spacing, spacing),
        origin,
        scale.unit,
        slopes,
        lattice.pitch * scale.pixel,
        fit,
        _warnings(data, optics, calibration),
    )


def _to_light(pixels: Array, calibration: Calibration) -> Singles:
    """(H, W) mean over the channels, as floats that are 1 at white.

    Flats of 8 bits are taken for linear, as sensors of microscopes give them, unless the camera
    tells otherwise.
    """
    light = pixels.astype(np.float32)
    if pixels.dtype.kind != "f":
        light /= np.float32(np.iinfo(pixels.dtype).max)
    if calibration.encoded:
        light *= light
    return light.mean(2, dtype=np.float32)


def _rim_radius(calibration: Calibration) -> float:
    """Radius [px] at which a microimage has half its light; at most half the pitch."""
    lattice = calibration.lattice
    if calibration.vignetting is None:
        return lattice.radius
    radii = np.arange(0.0, lattice.pitch / 2, 0.05)
    lit = calibration.vignetting.at(radii) >= 0.5
    return float(radii[lit].max(initial=lattice.radius))


def _depths(
    given: tuple[float, float] | None, planes: int, scale: Scale, pitch: float, reach: float
) -> Floats:
    """(planes,) depth of each plane."""
    widest = _DEFAULT_REACH * pitch / scale.slope_per_depth
    first, last = (-widest, widest) if given is None else (float(end) for end in given)
    if not (np.isfinite([first, last]).all() and first < last):
        given_ends = f"{first:g} and {last:g}"
        raise ValueError(f"depth_range must be two numbers, the smaller first, got {given_ends}")
    farthest = max(abs(first), abs(last)) * scale.slope_per_depth
    if farthest * reach < pitch / 2:
        unit = ""
        if scale.unit == "um":
            unit = " um"
        least = pitch / (2 * reach) / scale.slope_per_depth
        raise ValueError(
            f"depth_range lies within {least:.3g}{unit} of the native plane, where one place is "
            "resolved for each microlens ('lfrender render --traditional' draws it); give a wider "
            "one"
        )
    if farthest > 4 * pitch:
        unit = "(slopes k)"
        if scale.unit == "um":
            unit = "um"
        limit = 4 * pitch / scale.slope_per_depth
        raise ValueError(
            f"depth_range reaches {first:g} to {last:g} {unit}, but beyond {limit:.3g} a pixel "
            "averages over four microlenses; give a narrower one, or check the optics"
        )
    return np.linspace(first, last, planes)


def _warnings(
    data: Singles,
    optics: Microscope,
    calibration: Calibration,
) -> tuple[str, ...]:
    """What a user should know before relying on a volume."""
    warnings = list(calibration.warnings)
    if not optics.metric:
        missing = (
            f"without {optics.missing()} the volume is in pixels of the flat, its depth in slopes "
            "k = -D / s"
        )
        if optics.na is None:
            missing += ", and rays are paraxial: at a high NA, depths are bent"
        warnings.append(missing)
    if calibration.gain_map is None and calibration.vignetting is None:
        warnings.append(
            "the camera does not know the light of its microimages; calibrate it on a white image"
        )
    light = data.sum((1, 2), dtype=float)
    much = _MUCH_LIGHT * np.median(light)
    ends = [name for name, at in (("first", 0), ("last", -1)) if light[at] > much]
    if ends:
        where = " and the ".join(ends)
        warnings.append(
            f"much light lies on the {where} plane: the specimen may reach beyond the range"
        )
    return tuple(warnings)
