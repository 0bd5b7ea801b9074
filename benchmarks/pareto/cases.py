"""Test cases: simulated scenes, and ray-traced flats of a folder."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import compare_pictures, resample

__all__ = ["Case", "of_folder", "simulated"]

# Full well and readout noise [electrons] of a middling sensor.
_NOISE = (12000.0, 5.0)
_RESOLVABLE = 0.75


@dataclass(frozen=True)
class Case:
    """A flat with its truth.

    Parameters
    ----------
    name : str
    flat, white : (H, W, 3) and (H, W) arrays
    calibration : Calibration
        The true one, or the one found on the white image where none is known exactly.
    centres : (n, 2) [px]
    patch_size, mode : (n,)
    single : (n,) bool
        Lenses that show one depth only.
    reference, affine, depth : (h, w, 3), (2, 3), (h, w)
        The picture, its grid, and the signed patch size there.
    """

    name: str
    flat: NDArray[Any]
    white: NDArray[Any]
    calibration: lfcal.Calibration
    centres: NDArray[np.float64]
    patch_size: NDArray[np.float64]
    mode: NDArray[np.int8]
    single: NDArray[np.bool_]
    reference: NDArray[Any]
    affine: NDArray[np.float64]
    depth: NDArray[np.float32]

    @property
    def megapixels(self) -> float:
        """Size of the flat in megapixels."""
        return self.flat.shape[0] * self.flat.shape[1] / 1e6

    def centre_rms(self, lattice: lfcal.Lattice) -> float:
        """RMS error of the centres [px]; infinite for a wrong lattice."""
        from scipy.spatial import cKDTree

        found = lattice.centres()
        distance, row = cKDTree(self.centres).query(found)
        inner = distance < 0.5 * lattice.pitch
        if len(np.unique(row[inner])) < 0.95 * len(self.centres):
            return float("inf")
        return float(np.sqrt((distance[inner] ** 2).mean()))

    def depth_errors(self, patch_size: NDArray[Any]) -> dict[str, float]:
        """Median and 95 % error [px] of the patch sizes (n,) of the lenses, and shares with a wrong
        mode and none.
        """
        from scipy.spatial import cKDTree

        centres = self.calibration.lattice.centres()
        row = cKDTree(self.centres).query(centres)[1]
        asked = (self.mode[row] != 0) & self.single[row]
        known = asked & np.isfinite(patch_size)
        error = np.abs(patch_size - self.patch_size[row])[known]
        wrong = known & (np.sign(patch_size) != self.mode[row])
        return {
            "s median px": float(np.median(error)) if known.any() else float("inf"),
            "s 95 % px": float(np.percentile(error, 95)) if known.any() else float("inf"),
            "modes wrong": float(wrong.sum() / asked.sum()),
            "unresolved": float(1 - known.sum() / asked.sum()),
        }

    def picture_merit(self, picture: lfrender.Rendering) -> dict[str, float]:
        """PSNR [dB] and SSIM over resolvable places at least a pitch from the border."""
        shape = picture.image.shape[:2]
        wanted, inside = resample(self.reference, self.affine, shape, picture.affine)
        v, u = np.mgrid[: shape[0], : shape[1]]
        points = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ picture.affine.T
        back = np.linalg.inv(np.vstack([self.affine, [0, 0, 1]]))
        i, j = np.rint(np.column_stack([points, np.ones(len(points))]) @ back[:2].T).astype(int).T
        rows, columns = self.depth.shape
        s = self.depth[np.clip(j, 0, rows - 1), np.clip(i, 0, columns - 1)].reshape(shape)
        border = int(np.ceil(picture.scale))
        inner = np.zeros(shape, bool)
        inner[border:-border, border:-border] = True
        where = (
            inside
            & inner
            & picture.valid
            & (np.abs(s) < _RESOLVABLE * self.calibration.lattice.pitch)
        )
        found = compare_pictures(
            picture.image / np.float64(np.iinfo(picture.image.dtype).max), wanted, where
        )
        return {"PSNR dB": found.psnr, "SSIM": found.ssim}


def simulated(full: bool) -> Iterator[Case]:
    """Scenes of `data_synth`: small ones, or of a megapixel with three lens types as well."""
    size, samples = ((1300, 1000), 48) if full else ((520, 400), 16)
    for name in ("house", "clutter", "slope", "plane"):
        for focus in (0.04, (0.15, 0.3, 0.45)) if full else (0.04,):
            camera = Camera.design(size=size, pitch=23.2, rotation=1.3, focus=focus)
            shot = simulate(SCENES[name](camera), camera, samples=samples, seed=2, noise=_NOISE)
            truth = shot.truth
            yield Case(
                name if isinstance(focus, float) else f"{name}, 3 types",
                shot.flat,
                shot.white,
                truth.calibration,
                truth.calibration.lattice.centres(),
                truth.patch_size,
                truth.mode,
                ~truth.mixed,
                truth.reference,
                truth.reference_affine,
                truth.reference_patch_size,
            )


def of_folder(folder: Path) -> Iterator[Case]:
    """Ray-traced flats, one in each folder below: flat.png, white.png, microlenses.npz and a
    reference.
    """
    for path in sorted(folder.iterdir()):
        if not (path / "microlenses.npz").exists():
            continue
        truth = np.load(path / "microlenses.npz")
        depth = np.load(path / "reference_depth.npz")["disparity_px"]
        white = lfcal.read_flat(path / "white.png")
        yield Case(
            path.name,
            lfcal.read_flat(path / "flat.png"),
            white,
            lfcal.calibrate(white),
            truth["centre_px"],
            truth["disparity_px"],
            truth["mode"],
            ~truth["mixed"].astype(bool),
            lfcal.read_flat(path / "reference.png"),
            np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5]]),
            depth,
        )
