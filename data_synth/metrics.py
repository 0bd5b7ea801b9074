"""Errors of a calibration, a depth map and a picture against known truth: RMS, shares, PSNR and
SSIM.

Pictures are compared on the grid of the rendered one: the reference is averaged over the footprint
of each of its pixels, so that a difference in resolution alone is no error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from lfcal import Lattice

__all__ = [
    "PictureQuality",
    "centre_error",
    "compare_pictures",
    "magnification_error",
    "mode_accuracy",
    "resample",
]


@dataclass(frozen=True)
class PictureQuality:
    """Similarity of a picture to its reference.

    Parameters
    ----------
    psnr : float [dB]
        Peak signal to noise ratio, infinite for equal pictures.
    ssim : float
        Structural similarity (Wang et al. 2004: Gaussian window of 1.5 px), 1 for equal pictures.
    pixels : int
        Number of pixels compared.
    gain : (channels,) float64
        Factor on each channel of the picture that brings it nearest to the reference.
    """

    psnr: float
    ssim: float
    pixels: int
    gain: NDArray[np.float64]


def compare_pictures(
    picture: NDArray[Any], reference: NDArray[Any], where: NDArray[np.bool_] | None = None
) -> PictureQuality:
    """PSNR and SSIM of a picture against a reference on the same grid, with one free gain per
    channel.

    The gain takes out exposure and the transmission of the microlenses, which calibration cannot
    know. The peak is the largest value of the pixel type, 1 for float.

    Parameters
    ----------
    picture, reference : (h, w) or (h, w, 3) uint8, uint16 or float
        Same shape; the types may differ.
    where : (h, w) bool, optional
        Pixels to compare. Where an SSIM window reaches beyond them, the reference stands for the
        picture.

    Raises
    ------
    ValueError
        If the shapes differ or there is no pixel to compare.
    """
    if picture.shape != reference.shape or picture.ndim not in (2, 3):
        raise ValueError(
            f"picture and reference must be of one shape, got {picture.shape} and {reference.shape}"
        )
    mask = np.ones(picture.shape[:2], bool) if where is None else np.asarray(where, bool)
    if mask.shape != picture.shape[:2] or not mask.any():
        raise ValueError(f"where must choose at least one pixel of {picture.shape[:2]}")
    image, truth = (
        _to_unit_range(pixels).reshape(*mask.shape, -1) for pixels in (picture, reference)
    )
    p = image[mask]
    t = truth[mask]
    energy = (p * p).sum(0)
    gain = np.divide((p * t).sum(0), energy, out=np.ones_like(energy), where=energy > 0)
    error = float(np.mean((p * gain - t) ** 2))
    psnr = float("inf") if error == 0 else float(-10 * np.log10(error))
    matched = np.where(mask[..., None], image * gain, truth)
    return PictureQuality(psnr, _ssim(matched, truth, mask), int(mask.sum()), gain)


def resample(
    reference: NDArray[Any], reference_affine: ArrayLike, shape: tuple[int, int], affine: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """A picture resampled to the grid of another one, as means over the other's pixels.

    Parameters
    ----------
    reference : (h, w) or (h, w, 3)
        The picture to resample; integer types are scaled to 0..1.
    reference_affine, affine : (2, 3) array_like
        From pixel `(u, v)` to scene coordinates, of the picture and of the grid.
    shape : (int, int)
        Height and width of the grid.

    Returns
    -------
    picture : (h, w) or (h, w, 3) float64
        0 where the reference does not reach.
    inside : (h, w) bool
        Where it does.
    """
    from scipy.ndimage import affine_transform

    to_reference = np.linalg.inv(_square(reference_affine)) @ _square(affine)
    # With samples at most one reference pixel apart, their mean is the mean over the footprint.
    n = int(np.ceil(np.abs(to_reference[:2, :2]).sum(0).max() - 1e-9)) or 1
    steps = (np.arange(n) + 0.5) / n - 0.5
    planes = np.moveaxis(_to_unit_range(reference).reshape(*reference.shape[:2], -1), -1, 0)
    matrix = to_reference[:2, :2][::-1, ::-1]
    total = np.zeros((len(planes), *shape))
    for du in steps:
        for dv in steps:
            offset = (to_reference @ [du, dv, 1.0])[1::-1]
            for plane, out in zip(planes, total, strict=True):
                out += affine_transform(
                    plane, matrix, offset, shape, order=1, mode="nearest", prefilter=False
                )
    inside = _inside(to_reference, steps, reference.shape[:2], shape)
    picture = np.moveaxis(np.where(inside, total / n**2, 0.0), 0, -1)
    return picture.reshape(*shape, *reference.shape[2:]), inside


def _inside(
    to_reference: NDArray[np.float64],
    steps: NDArray[np.float64],
    size: tuple[int, ...],
    shape: tuple[int, int],
) -> NDArray[np.bool_]:
    """Pixels of the grid whose outermost samples all lie on the area of the reference's pixels."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    inside = np.ones(shape, bool)
    limits = np.array([size[1], size[0]]) - 0.5 + 1e-9
    for du in (steps[0], steps[-1]):
        for dv in (steps[0], steps[-1]):
            where = np.stack([u + du, v + dv, np.ones(shape)], -1) @ to_reference[:2].T
            inside &= ((where >= -0.5 - 1e-9) & (where <= limits)).all(-1)
    return inside


def centre_error(lattice: Lattice, truth: Lattice) -> float:
    """RMS distance [px] of the true microimage centres on the flat from the nearest centre of
    `lattice`.
    """
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(lattice.centres()).query(truth.centres())
    return float(np.sqrt(np.mean(distance**2)))


def mode_accuracy(mode: ArrayLike, truth: ArrayLike, where: NDArray[np.bool_]) -> float:
    """Share of the lenses in `where` (n,) whose mode (1, -1, 0) is the true one; NaN if there are
    none.
    """
    right = (np.asarray(mode) == np.asarray(truth))[where]
    return float(right.mean()) if right.size else float("nan")


def magnification_error(patch_size: ArrayLike, truth: ArrayLike, where: NDArray[np.bool_]) -> float:
    """Median relative error of the magnification `M = D / |s|` over the lenses in `where` (n,).

    Lenses without a patch size (NaN) count as an error of 1. NaN if there are no lenses.
    """
    s = np.abs(np.asarray(patch_size, dtype=float))[where]
    s_true = np.abs(np.asarray(truth, dtype=float))[where]
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.abs(s_true / s - 1)
    return (
        float(np.median(np.where(np.isfinite(error), error, 1.0))) if error.size else float("nan")
    )


def _to_unit_range(image: NDArray[Any]) -> NDArray[np.float64]:
    scale = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1.0
    return image.astype(np.float64) / scale


def _square(affine: ArrayLike) -> NDArray[np.float64]:
    rows = np.asarray(affine, dtype=np.float64)
    if rows.shape != (2, 3):
        raise ValueError(f"affine must be 2x3, got shape {rows.shape}")
    return np.vstack([rows, [0.0, 0.0, 1.0]])


def _ssim(
    picture: NDArray[np.float64], reference: NDArray[np.float64], mask: NDArray[np.bool_]
) -> float:
    from skimage.metrics import structural_similarity

    if min(mask.shape) < 11:
        return float("nan")
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    _, local = structural_similarity(
        picture, reference, data_range=1.0, channel_axis=-1, full=True, **options
    )
    return float(local[mask].mean())
