"""Depth and pictures of ray-traced flats against their truth: `python -m benchmarks.truth_flats
../shared/truth`.

Only the flat is given; the lattice is calibrated from it. Modes and patch sizes are judged on
resolvable lenses with texture; pictures are judged where the true |s| is below 0.75 D, with one
gain per channel. The edge figure is the share of places at depth edges whose right depth lies
within one pixel of the traditional picture.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import lfcal
import lfrender
from data_synth.metrics import PictureQuality, compare_pictures, resample
from lfrender.runtime.choices import Preset

from .depth_edges import RESOLVABLE, edge_share

# Reference pixel (i, j) of these folders lies at scene coordinates X = (2i + 0.5, 2j + 0.5).
_REFERENCE = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5]])
SCALES = (0.15, 0.3)
_BLANK = 2


def merit(picture: lfrender.Rendering, folder: Path, pitch: float) -> PictureQuality:
    """PSNR and SSIM over resolvable pixels, a pitch off the border."""
    reference = lfcal.read_flat(folder / "reference.png")
    patch_size = np.load(folder / "reference_depth.npz")["disparity_px"]
    shape = picture.image.shape[:2]
    wanted, inside = resample(reference, _REFERENCE, shape, picture.affine)
    v, u = np.mgrid[: shape[0], : shape[1]]
    points = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ picture.affine.T
    i, j = np.rint((points - 0.5) / 2).astype(int).T
    s = patch_size[
        np.clip(j, 0, len(patch_size) - 1), np.clip(i, 0, patch_size.shape[1] - 1)
    ].reshape(shape)
    border = int(np.ceil(picture.scale))
    inner = np.zeros(shape, bool)
    inner[border:-border, border:-border] = True
    where = inside & inner & picture.valid & (np.abs(s) < RESOLVABLE * pitch)
    return compare_pictures(
        picture.image / np.float64(np.iinfo(picture.image.dtype).max), wanted, where
    )


def measure(folder: Path, preset: Preset) -> dict[str, Any]:
    """Errors of centres, modes, patch sizes and pictures, and seconds of depth and picture."""
    flat = lfcal.read_flat(folder / "flat.png")
    calibration = lfcal.calibrate(flat)
    lfrender.render(flat, calibration, lfrender.analyze(flat, calibration, preset))
    start = time.perf_counter()
    depth = lfrender.analyze(flat, calibration, preset)
    analysed = time.perf_counter()
    picture = lfrender.render(flat, calibration, depth)
    drawn = time.perf_counter()
    truth = np.load(folder / "microlenses.npz")
    distance, nearest = cKDTree(truth["centre_px"]).query(calibration.lattice.centres())
    known = distance < 0.25 * calibration.lattice.pitch
    mode: NDArray[np.int8] = truth["mode"][nearest]
    single = known & (mode != 0) & ~truth["mixed"][nearest].astype(bool)
    every = known & (mode != 0)
    error = np.abs(depth.patch_size - truth["disparity_px"][nearest])[single]
    stated = np.isfinite(depth.standard_error[single])
    within = (error <= depth.standard_error[single])[stated].mean()
    blank = known & (truth["reason"][nearest] & _BLANK > 0)
    claims = (
        f"{(depth.confidence[blank] > 0.5).mean():.3f} of {blank.sum()}" if blank.any() else "none"
    )
    pitch = calibration.lattice.pitch
    edges = edge_share(depth, np.load(folder / "reference_depth.npz")["disparity_px"], _REFERENCE)
    psnr = [
        merit(lfrender.render(flat, calibration, depth, scale=k * pitch), folder, pitch).psnr
        for k in SCALES
    ]
    psnr.append(merit(picture, folder, pitch).psnr)
    # The one patch size that fits most lenses, for all of them.
    middle = float(np.median(truth["disparity_px"][nearest][single]))
    flattened = lfrender.render(flat, calibration, patch_size=middle, scale=picture.scale)
    return {
        "name": folder.name,
        "centres": float(np.sqrt((distance[known] ** 2).mean())),
        "modes": float((depth.mode == mode)[single].mean()),
        "all_modes": float((depth.mode == mode)[every].mean()),
        "median": float(np.nanmedian(error)),
        "most": float(np.nanpercentile(error, 95)),
        "within": float(within),
        "claims": claims,
        "edges": float(edges),
        "psnr": psnr,
        "one_patch_size": merit(flattened, folder, pitch).psnr,
        "scale": picture.scale,
        "seconds": (analysed - start, drawn - analysed),
    }


def _row(folder: Path, preset: Preset) -> str:
    found = measure(folder, preset)
    psnr = " ".join(f"{value:.2f}" for value in found["psnr"])
    return (
        f"{found['name']:10} {preset:9} centres {found['centres']:.4f} px"
        f"  modes {found['modes']:.4f} / all {found['all_modes']:.4f}"
        f"  s median {found['median']:.3f} 95 % {found['most']:.3f} px"
        f" within its error {found['within']:.2f}  blank claims {found['claims']}"
        f"  edges {found['edges']:.3f}"
        f"  PSNR {psnr} dB (P = 0.15 D, 0.3 D, {found['scale']:.1f})"
        f"  {found['seconds'][0]:.2f} + {found['seconds'][1]:.2f} s"
    )


if __name__ == "__main__":
    for path in sorted(Path(sys.argv[1]).iterdir()):
        if path.is_dir():
            for name in get_args(Preset):
                if name in (sys.argv[2:] or ["balanced"]):
                    print(_row(path, name), flush=True)
