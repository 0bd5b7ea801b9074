"""Take the picture: trace the flat and the white image, and note down the truth; true views from
the aperture.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from lfcal.gain.gain_map import Vignetting

from .camera import Camera
from .capture import Capture, Truth
from .surfaces import Patch, Scene
from .transfer import EXPOSURE, develop, to_srgb

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["simulate", "true_view"]

_REFERENCE_STEP = 2
_REFERENCE_SAMPLES = 16
# Beyond this share of D neighbouring microimages have too little in common to be compared.
_LARGEST_RATIO = 0.75
# Relative contrast below which a lens counts as textureless, the radius it is taken in (of D), and
# the spread of s (of D) from which on a lens sees several depths.
_LEAST_CONTRAST = 0.02
_DISC = 0.36
_MIXED_SPREAD = 0.07


def simulate(
    scene: Scene,
    camera: Camera,
    *,
    samples: int = 48,
    seed: int = 0,
    noise: tuple[float, float] | None = None,
    bits: int = 8,
    gamma: bool = True,
) -> Capture:
    """Render the flat of a scene by tracing rays through both lenses, together with all that is
    true about it.

    Parameters
    ----------
    scene : Scene
        Surfaces in object space, for example from `SCENES["house"](camera)`.
    camera : Camera
    samples : int
        Rays per pixel and microlens; 48 leave about 1 % of white as RMS sampling noise on a
        detailed scene.
    seed : int
        Of sampling and noise; the same seed gives the same capture bit for bit.
    noise : (full_well, read) or None [electrons]
        Photon noise of a sensor that saturates at `full_well` electrons, and its read noise.
    bits : 8 or 16
    gamma : bool
        Store through the sRGB curve; False stores linear values.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Examples
    --------
    >>> from data_synth import SCENES, Camera, simulate
    >>> camera = Camera.design(size=(120, 90), pitch=20)
    >>> capture = simulate(SCENES["blank"](camera), camera, samples=1)
    >>> capture.flat.shape, capture.white.shape
    ((90, 120, 3), (90, 120))
    """
    if not camera.straight:
        raise ValueError(
            "simulate knows the truth of cameras without distortion and tilt; use shoot_board"
        )
    if not 1 <= samples <= 1 << 16:
        raise ValueError(f"samples must be 1 to {1 << 16}, got {samples}")
    if bits not in (8, 16):
        raise ValueError(f"bits must be 8 or 16, got {bits}")
    if not 0 <= seed < 1 << 32:
        raise ValueError(f"seed must be 0 to {(1 << 32) - 1}, got {seed}")
    if noise is not None and not (
        len(noise) == 2 and np.isfinite(noise).all() and noise[0] > 0 and noise[1] >= 0
    ):
        raise ValueError(f"noise must be (full_well > 0, read >= 0) in electrons, got {noise}")
    from . import tracing
    from .intersection import pack

    table, texels = pack(scene)
    flat = tracing.sensor(table, texels, scene.background, camera, samples, seed)[..., :3]
    flat = _add_stray_light(flat, camera) * np.array(camera.filters, np.float32)
    # Rays of its own: a white image that shared the flat's sampling errors would cancel them.
    white = tracing.sensor(table[:0], texels, (1.0, 1.0, 1.0), camera, samples, seed + 1)[..., 3]
    white = _add_stray_light(white, camera)
    streams = np.random.default_rng(seed).spawn(2)

    def store(
        picture: NDArray[np.float32], light: tuple[float, float] | None, rng: np.random.Generator
    ) -> NDArray[Any]:
        return develop(picture, noise=light, bits=bits, gamma=gamma, rng=rng)

    recipe = {"scene": scene.name, "samples": samples, "seed": seed, "noise": noise and list(noise)}
    # Vignetting is that of stored numbers, and 16 bits hardly round it.
    shading = develop(white, noise=None, bits=16, gamma=gamma, rng=streams[1])
    return Capture(
        flat=store(_behind_filters(flat, camera), noise, streams[0]),
        white=store(
            _behind_filters(white[..., None] * np.array(camera.filters, np.float32), camera),
            noise,
            streams[1],
        )
        if camera.mosaic
        else store(white, noise, streams[1]),
        truth=_truth(
            scene,
            camera,
            table,
            texels,
            flat,
            shading,
            seed,
            lambda picture: store(picture, None, streams[0]),
        ),
        camera=camera,
        recipe=recipe | {"bits": bits, "gamma": gamma, "exposure": EXPOSURE},
    )


def true_view(
    scene: Scene,
    camera: Camera,
    offset: tuple[float, float],
    affine: ArrayLike,
    size: tuple[int, int],
    *,
    samples: int = 16,
    seed: int = 0,
) -> NDArray[np.float32]:
    """What a pinhole shows at the place in the main lens that microimages show at `offset` from
    their centres.

    The lens is a thin one: moved by `A`, it bends all rays by `A / f` less, which moves the picture
    on the microlens plane by `A (1 - L / f)`.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    offset : (float, float) [px]
        `q` of docs/geometry.md.
    affine : (2, 3) array_like
        From output pixel `(u, v, 1)` to the microlens plane [flat px], where the point that is
        drawn at `Y` is seen by the lens with its centre at `Y`, at `Y + q`.
    size : (int, int) [px]
        Width and height of the picture.
    samples : int
        Rays per pixel.
    seed : int
        Of the sampling.

    Returns
    -------
    (h, w, 3) float32
        Through the sRGB curve, 0 to 1.

    Examples
    --------
    >>> from data_synth import SCENES, Camera, simulate
    >>> camera = Camera.design(size=(120, 90), pitch=20)
    >>> affine = [[2, 0, 10], [0, 2, 10]]
    >>> true_view(SCENES["plane"](camera), camera, (0, 0), affine, (50, 35), samples=1).shape
    (35, 50, 3)
    """
    from . import tracing
    from .intersection import pack

    # From the sensor at c + q through the lens at c, whichever lens that is.
    place = -np.asarray(offset, float) * camera.pixel * camera.mla_distance / camera.sensor_distance
    # Flats are upright: their axes point against those of the object space.
    moved = []
    for surface in scene.surfaces:
        name = "corner" if isinstance(surface, Patch) else "centre"
        moved.append(replace(surface, **{name: getattr(surface, name) + np.array([*place, 0.0])}))
    table, texels = pack(Scene(scene.name, tuple(moved), scene.background))
    shift = place * (1 - camera.mla_distance / camera.focal_length) * camera.spread / camera.pixel
    grid = np.array(affine, float) - np.column_stack([np.zeros((2, 2)), shift])
    light = tracing.pinhole(table, texels, scene.background, camera, grid, size, samples, seed)[
        ..., :3
    ]
    return to_srgb(light).astype(np.float32)


def _add_stray_light(light: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """`light` (H, W) or (H, W, 3) of which a share is spread over about a pitch: it came past the
    microlenses.
    """
    if camera.stray == 0:
        return light
    spread = gaussian_filter(light, camera.pitch, axes=(0, 1))
    return np.asarray((1 - camera.stray) * light + camera.stray * spread, np.float32)


def _behind_filters(light: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """(H, W) what pixels see of `light` (H, W, 3) behind the camera's colour filters; all of it if
    it has none.
    """
    if camera.mosaic is None:
        return light
    seen = np.empty(light.shape[:2], np.float32)
    for place, colour in enumerate(camera.mosaic):
        phase = np.s_[place // 2 :: 2, place % 2 :: 2]
        seen[phase] = light[(*phase, "RGB".index(colour))]
    return seen


def _truth(
    scene: Scene,
    camera: Camera,
    table: NDArray[np.float64],
    texels: NDArray[np.float32],
    flat: NDArray[np.float32],
    shading: NDArray[np.uint16],
    seed: int,
    store: Callable[[NDArray[np.float32]], NDArray[Any]],
) -> Truth:
    """Everything known about the capture, from chief rays, the noise-free flat, and the white image
    as stored.
    """
    from . import tracing

    lattice = camera.lattice
    centres = lattice.centres()
    ij = lattice.indices()
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64)
    own = _nearest_centres(camera, pixels)
    start, slope = _chief_rays(camera, pixels, own)
    types = camera.lens_types(np.rint(lattice.to_index(own)).astype(np.int64))
    along = np.linalg.qr(lattice.basis.T)[0] if camera.square_aperture else np.eye(2)
    reach = np.abs(start @ along).max(1) if camera.square_aperture else np.hypot(*start.T)
    inside = reach <= camera.half_apertures(types)
    seen = np.full(len(pixels), np.nan)
    seen[inside] = camera.patch_size(tracing.nearest(table, texels, start[inside], slope[inside]))
    disparity = seen.reshape(flat.shape[:2])

    patch_size = camera.patch_size(
        tracing.nearest(table, texels, *_chief_rays(camera, centres, centres))
    )
    contrast, mixed = _look_into_discs(
        camera, centres, flat @ np.array([0.2126, 0.7152, 0.0722]), disparity
    )
    resolvable = (np.abs(patch_size) <= _LARGEST_RATIO * camera.pitch) & (
        contrast >= _LEAST_CONTRAST
    )
    mode = np.where(resolvable, np.sign(patch_size), 0).astype(np.int8)

    size = (camera.width // _REFERENCE_STEP or 1, camera.height // _REFERENCE_STEP or 1)
    affine = np.array([[_REFERENCE_STEP, 0.0, 0.5], [0.0, _REFERENCE_STEP, 0.5]])
    reference = tracing.pinhole(
        table, texels, scene.background, camera, affine, size, _REFERENCE_SAMPLES, seed
    )
    reference = reference[..., :3] * np.array(camera.filters, np.float32)
    v, u = np.mgrid[0 : size[1], 0 : size[0]]
    points = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ affine.T
    depths = tracing.nearest(table, texels, *_chief_rays(camera, points, points))
    return Truth(
        calibration=camera.calibration(_vignetting(camera, pixels - own, shading.ravel())),
        patch_size=patch_size,
        mode=mode,
        magnification=np.where(mode != 0, camera.pitch / np.abs(patch_size), np.nan),
        mixed=mixed,
        contrast=contrast,
        lens_type=camera.lens_types(ij).astype(np.int8),
        disparity=disparity.astype(np.float32),
        reference=store(reference),
        reference_affine=affine,
        reference_patch_size=camera.patch_size(depths).reshape(v.shape).astype(np.float32),
    )


def _nearest_centres(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) the microimage centre nearest to each flat position: of a shortest basis, one of four
    corners.
    """
    lattice = camera.lattice
    index = lattice.to_index(points)
    corner = np.floor(index)
    i, j = (index - corner).T
    a, b = lattice.basis
    steps = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
    squares = [
        (i - m) ** 2 * (a @ a) + (j - n) ** 2 * (b @ b) + 2 * (i - m) * (j - n) * (a @ b)
        for m, n in steps
    ]
    return lattice.origin + (corner + steps[np.argmin(squares, axis=0)]) @ lattice.basis


def _chief_rays(
    camera: Camera, pixels: NDArray[np.float64], centres: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rays from flat positions through the middle of their microlens: start on the main lens and
    slope behind it.
    """
    sensor = (pixels - camera.principal_point) * camera.pixel
    lens = (centres - camera.principal_point) * camera.pixel / camera.spread
    slope = (lens - sensor) / camera.sensor_distance
    start = lens + slope * camera.mla_distance
    return start, slope - start / camera.focal_length


def _look_into_discs(
    camera: Camera,
    centres: NDArray[np.float64],
    luminance: NDArray[np.float64],
    disparity: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Per lens: relative contrast, and whether the disc of 0.36 D shows several depths (2nd to 98th
    percentile).
    """
    radius = _DISC * camera.pitch
    reach = int(np.ceil(radius)) + 1
    contrast = np.zeros(len(centres))
    mixed = np.zeros(len(centres), bool)
    for n, (x, y) in enumerate(centres):
        left = max(round(x) - reach, 0)
        top = max(round(y) - reach, 0)
        window = np.s_[top : round(y) + reach + 1, left : round(x) + reach + 1]
        light = luminance[window]
        depth = disparity[window]
        rows, columns = np.ogrid[: light.shape[0], : light.shape[1]]
        disc = (columns + left - x) ** 2 + (rows + top - y) ** 2 <= radius * radius
        values = light[disc]
        depths = depth[disc]
        if values.size and values.mean() > 0:
            contrast[n] = values.std() / values.mean()
        depths = np.sort(depths[np.isfinite(depths)])
        if depths.size:
            low = depths[int(0.02 * (depths.size - 1))]
            high = depths[int(np.ceil(0.98 * (depths.size - 1)))]
            mixed[n] = high - low > _MIXED_SPREAD * camera.pitch
    return contrast, mixed


def _vignetting(
    camera: Camera, delta: NDArray[np.float64], white: NDArray[np.uint16]
) -> Vignetting:
    """Mean stored light of all microimages over the distance from their centres, out to the half
    pitch.
    """
    step = 0.5
    bins = np.rint(np.hypot(*delta.T) / step).astype(int)
    last = max(int(np.ceil(camera.pitch / 2 / step)), 2)
    kept = bins <= last
    count = np.bincount(bins[kept], minlength=last + 1)
    light = np.bincount(bins[kept], white[kept], minlength=last + 1)
    found = count > 0
    profile = np.interp(np.arange(last + 1), np.flatnonzero(found), light[found] / count[found])
    return Vignetting(profile / max(profile.max(), 1e-12), step)
