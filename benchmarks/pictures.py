"""Pictures of ray-traced flats against their references: `python -m benchmarks.pictures ../shared/truth`.

Prints PSNR and SSIM of all-in-focus pictures at 0.15 D, 0.3 D and the default scale, drawn with the depth found on the
flat, and with the true one, which tells what is lost by drawing alone.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import distance_transform_edt

import lfcal
import lfrender
from lfrender.surface import Surface

from .truth_flats import SCALES, merit


def _true_depth(folder: Path, depth: lfrender.DepthMap) -> lfrender.DepthMap:
    """The depth map with the surface of the truth, filled from the nearest value where nothing was hit."""
    size = np.load(folder / "reference_depth.npz")["disparity_px"].astype(np.float32)
    nearest = distance_transform_edt(~np.isfinite(size), return_distances=False, return_indices=True)
    return replace(depth, surface=Surface(np.ascontiguousarray(size[tuple(nearest)]), (0.5, 0.5), 2.0))


def _rows(folder: Path) -> str:
    flat = lfcal.read_flat(folder / "flat.png")
    calibration = lfcal.calibrate(flat)
    depth = lfrender.analyze(flat, calibration)
    pitch = calibration.lattice.pitch
    lines = []
    for scale in (*(share * pitch for share in SCALES), lfrender.default_scale(depth)):
        found = [
            merit(lfrender.render(flat, calibration, which, scale=scale), folder, pitch)
            for which in (depth, _true_depth(folder, depth))
        ]
        figures = " | ".join(f"{one.psnr:.1f} dB / {one.ssim:.3f}" for one in found)
        lines.append(f"| {folder.name} | {scale:.1f} | {figures} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print("| scene | pixels per pitch | lfrender | lfrender, true depth |\n|---|---|---|---|")
    for path in sorted(Path(sys.argv[1]).iterdir()):
        if path.is_dir():
            print(_rows(path), flush=True)
