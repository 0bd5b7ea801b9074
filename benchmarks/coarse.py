"""Pictures of twelve scales against their references: `python -m benchmarks.coarse ../shared/truth
| FIRST LAST`.

The table shows PSNR [dB] from 0.06 to 0.3 pitches per pixel, with `detail="off"` and `"natural"`,
each with the depth of `balanced` and with the true depth. The reference is averaged over the exact
area of an output pixel, so that no scale has an advantage. Two numbers choose the random cameras
and scenes of `benchmarks.detail`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

import lfrender
from data_synth.metrics import compare_pictures, resample
from lfrender.runtime.choices import Detail

from .detail import Case, random_case, truth_cases
from .true_surface import with_true_surface

__all__ = ["main", "measure_psnr"]

_STEPS = (
    0.06,
    0.07,
    0.08,
    0.10,
    0.12,
    0.14,
    0.16,
    0.18,
    0.20,
    0.23,
    0.26,
    0.30,
)  # [pitch] per pixel
_RESOLVABLE = 0.75  # [pitch]


def average_areas(
    reference: NDArray[Any],
    affine: NDArray[np.float64],
    shape: tuple[int, int],
    wanted: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Means of a reference over the pixels of another grid.

    Pixels of the reference are means over their own squares. Their sums are known at their edges,
    and interpolated by cubic splines: if each were taken as even over its square, the reference
    would be softer than the scene, by 1.5 dB where a picture has hardly larger pixels.
    """
    mean = reference / (np.iinfo(reference.dtype).max if reference.dtype.kind in "ui" else 1.0)
    for axis, k in ((1, 0), (0, 1)):
        sums = np.insert(np.cumsum(mean, axis), 0, 0, axis)
        edges = wanted[k, k] * (np.arange(shape[axis] + 1) - 0.5) + wanted[k, 2]
        place = np.clip((edges - affine[k, 2]) / affine[k, k] + 0.5, 0, mean.shape[axis])
        until = make_interp_spline(np.arange(sums.shape[axis]), sums, 3, axis=axis)(place)
        broad = [1] * mean.ndim
        broad[axis] = -1
        mean = np.diff(until, axis=axis) / np.maximum(np.diff(place), 1e-9).reshape(broad)
    return np.asarray(mean)


def measure_psnr(case: Case, depth: lfrender.DepthMap, scale: float, detail: Detail) -> float:
    """PSNR [dB] of a picture against the reference averaged over the areas of its pixels."""
    picture = lfrender.render(case.flat, case.camera, depth, scale=scale, detail=detail)
    shape = picture.valid.shape
    beyond = ~(np.abs(case.size) < _RESOLVABLE * case.camera.lattice.pitch)
    lost, inside = resample(beyond * 1.0, case.affine, shape, picture.affine)
    border = int(np.ceil(picture.scale))
    inner = np.zeros(shape, bool)
    inner[border:-border, border:-border] = True
    image = picture.image / np.float64(np.iinfo(picture.image.dtype).max)
    wanted = average_areas(case.reference, case.affine, shape, picture.affine)
    return compare_pictures(
        image, wanted.reshape(image.shape), inside & inner & picture.valid & (lost == 0)
    ).psnr


def main(arguments: list[str]) -> None:
    """Print a row for each flat, kind of depth and detail."""
    cases: Iterator[Case]
    if len(arguments) > 1:
        cases = (random_case(seed) for seed in range(int(arguments[0]), int(arguments[1]) + 1))
    else:
        cases = truth_cases(Path(arguments[0]))
    print(
        f"| flat | depth | detail | {' | '.join(f'{step:.2f}' for step in _STEPS)} |\n"
        f"|{'---|' * (len(_STEPS) + 3)}"
    )
    for case in cases:
        own = lfrender.analyze(case.flat, case.camera)
        for name, depth in (
            ("balanced", own),
            ("true", with_true_surface(own, case.size, case.affine)),
        ):
            for detail in get_args(Detail):
                found = [
                    measure_psnr(case, depth, step * case.camera.lattice.pitch, detail)
                    for step in _STEPS
                ]
                print(
                    f"| {case.name} | {name} | {detail} | "
                    f"{' | '.join(f'{one:.1f}' for one in found)} |",
                    flush=True,
                )


if __name__ == "__main__":
    main(sys.argv[1:])
