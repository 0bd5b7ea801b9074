"""Detail of pictures against their references: `python -m benchmarks.detail [../shared/truth]`.

The table shows, at 0.15 D, 0.3 D and the default scale, the PSNR of the picture with
`detail="off"` and the gain [dB] of `detail="natural"`: in the whole picture, beside depth edges,
on blank places and in the border (a pitch wide). Three methods of scikit-image, applied to the
picture, follow: Wiener, Richardson-Lucy and total variation. They are given the disc of defocus
that is expected at the median patch size. Without a folder, the scenes of
`benchmarks.pictures` are simulated; `python -m benchmarks.detail 200 221` simulates random cameras
before random scenes, one for each number, some of them gray, of 16 bits, or JPEG of quality 50 or
75; with a third number all of those of 8 bits are JPEG of this quality.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

import lfcal
import lfrender
from data_synth import SCENES, Camera, Capture, simulate
from data_synth.metrics import resample
from lfrender.data.depth_map import default_scale
from lfrender.detail.blur import choose_blur, possible_discs

from .pictures import _SCENES, _SIZE
from .truth_flats import _REFERENCE, SCALES

_RESOLVABLE = 0.75
_LEAST_PIXELS = 500  # of a class, below which its figure is left out


class Case(NamedTuple):
    name: str
    flat: NDArray[Any]
    camera: lfcal.Calibration
    reference: NDArray[Any]
    affine: NDArray[np.float64]
    size: NDArray[np.float32]  # true patch size on the grid of the reference


def truth_cases(folder: Path) -> Iterator[Case]:
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            flat = lfcal.read_flat(path / "flat.png")
            reference = lfcal.read_flat(path / "reference.png")
            size = np.load(path / "reference_depth.npz")["disparity_px"].astype(np.float32)
            yield Case(path.name, flat, lfcal.calibrate(flat), reference, _REFERENCE, size)


def _simulated_cases() -> Iterator[Case]:
    for name, how in _SCENES.items():
        camera = Camera.design(size=_SIZE, **how.camera)
        shot = simulate(
            SCENES[how.scene](camera, **how.arguments), camera, samples=64, seed=7, **how.stored
        )
        truth = shot.truth
        found = lfcal.calibrate(shot.white, kind="white")
        yield Case(
            name,
            shot.flat,
            found,
            truth.reference,
            truth.reference_affine,
            truth.reference_patch_size.astype("f4"),
        )


def random_shot(seed: int, samples: int = 96) -> tuple[str, Camera, Capture]:
    """Name, camera and capture of a random scene before a random camera."""
    rng = np.random.default_rng(seed)
    kind = ("plane", "slope", "house", "clutter", "plane", "slope", "clutter")[seed % 7]
    several = seed % 7 >= 4 and seed % 2 == 0
    pitch = np.exp(rng.uniform(np.log(18), np.log(60)))
    lattice = "hex" if several else str(rng.choice(["hex", "hex-vertical", "square"]))
    turn = rng.uniform(-15, 15)
    fill = rng.uniform(0.14, 0.3)
    sign = rng.choice([-1.0, 1.0])
    focus: Any = sign * rng.uniform(-0.1, 0.25)
    if several:
        focus = tuple(sign * (rng.uniform(0.15, 0.25) + np.arange(3) * rng.uniform(0.11, 0.17)))
    camera = Camera.design(
        size=_SIZE, pitch=pitch, lattice=lattice, rotation=turn, fill=fill, focus=focus
    )
    near = rng.uniform(0.12, 0.25)
    far = rng.uniform(0.1, 0.3)
    where = {
        "plane": {"ratio": sign * (near + far)},
        "slope": {"left": sign * near, "right": sign * (near + far)},
    }
    scene = SCENES[kind](camera, seed=seed, **where.get(kind, {}))
    well = np.exp(rng.uniform(np.log(600), np.log(30000)))
    form: dict[str, Any] = {"bits": 16, "gamma": False} if seed % 5 == 3 else {}
    shot = simulate(scene, camera, samples=samples, seed=seed, noise=(well, 5), **form)
    return (
        f"{seed}: {kind}, D = {pitch:.0f} px" + (", three types" if several else ""),
        camera,
        shot,
    )


def random_case(seed: int, quality: int | None = None, samples: int = 96) -> Case:
    """The capture of `random_shot`, of some seeds as JPEG or in gray."""
    name, _, shot = random_shot(seed, samples)
    flat = shot.flat
    reference = shot.truth.reference
    if seed % 4 == 1:
        quality = quality or (50, 75)[seed // 4 % 2]
    if quality and flat.dtype == np.uint8:
        coded = cv2.imencode(".jpg", flat[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        flat = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR))[..., ::-1]
        name += f", JPEG {quality}"
    if seed % 6 == 2:
        flat, reference = (np.rint(np.mean(one, 2)).astype(one.dtype) for one in (flat, reference))
        name += ", gray"
    found = lfcal.calibrate(shot.white, kind="white")
    size = shot.truth.reference_patch_size.astype("f4")
    return Case(name, flat, found, reference, shot.truth.reference_affine, size)


def _classes(
    case: Case, wanted: NDArray[Any], inside: NDArray[np.bool_], picture: lfrender.Rendering
) -> list[Any]:
    """Masks: all, beside depth edges, blank, border; only the last includes the border."""
    shape = picture.image.shape[:2]
    pitch = case.camera.lattice.pitch
    v, u = np.mgrid[: shape[0], : shape[1]]
    places = np.stack([u, v, np.ones(shape)], -1) @ picture.affine.T
    grid = np.rint((places - case.affine[:, 2]) / case.affine[0, 0]).astype(int)
    known = np.clip(grid[..., ::-1], 0, np.array(case.size.shape) - 1)
    missing = distance_transform_edt(
        ~np.isfinite(case.size), return_distances=False, return_indices=True
    )
    s = case.size[tuple(missing)][known[..., 0], known[..., 1]]
    seen = inside & picture.valid & (np.abs(s) < _RESOLVABLE * pitch)
    border = int(np.ceil(picture.scale))
    inner = np.zeros(shape, bool)
    inner[border:-border, border:-border] = True
    jump = cv2.dilate(s, np.ones((3, 3))) - cv2.erode(s, np.ones((3, 3))) > 0.03 * pitch
    side = 2 * max(1, round(0.1 * picture.scale)) + 1
    edge = cv2.dilate(jump.view(np.uint8), np.ones((side, side), np.uint8)) > 0
    grey = wanted.reshape(*shape, -1).mean(-1).astype(np.float32)
    variance = cv2.blur(grey * grey, (9, 9)) - cv2.blur(grey, (9, 9)) ** 2
    return [
        seen & inner,
        seen & inner & edge,
        seen & inner & ~edge & (variance < 0.012**2),
        seen & ~inner,
    ]


def _psnr(image: NDArray[Any], wanted: NDArray[Any], where: NDArray[np.bool_]) -> float:
    if where.sum() < _LEAST_PIXELS:
        return float("nan")
    p = image[where]
    t = wanted[where]
    gain = (p * t).sum(0) / (p * p).sum(0)
    return float(-10 * np.log10(np.mean((p * gain - t) ** 2)))


def _disc(diameter: float) -> NDArray[np.float64]:
    half = int(np.ceil(diameter / 2))
    fine = (np.arange((2 * half + 1) * 9) - ((2 * half + 1) * 9 - 1) / 2) / 9
    disc = (
        (np.hypot(fine[:, None], fine) <= diameter / 2)
        .reshape(2 * half + 1, 9, 2 * half + 1, 9)
        .mean((1, 3))
    )
    return disc / disc.sum()


def _baselines(image: NDArray[Any], diameter: float) -> list[NDArray[Any]]:
    from skimage import restoration

    psf = _disc(max(diameter, 1.0))
    planes = np.moveaxis(image, -1, 0)
    found = [
        [restoration.wiener(plane, psf, 0.05, clip=False) for plane in planes],
        [restoration.richardson_lucy(np.maximum(plane, 1e-3), psf, 10) for plane in planes],
    ]
    return [np.stack(one, -1) for one in found] + [
        restoration.denoise_tv_chambolle(image, 0.01, channel_axis=-1)
    ]


def _rows(case: Case) -> Iterator[str]:
    depth = lfrender.analyze(case.flat, case.camera)
    pitch = case.camera.lattice.pitch
    for scale in (*(share * pitch for share in SCALES), default_scale(depth)):
        drawn = [
            lfrender.render(case.flat, case.camera, depth, scale=scale, detail="off"),
            lfrender.render(case.flat, case.camera, depth, scale=scale, detail="natural"),
        ]
        white = np.float64(np.iinfo(drawn[0].image.dtype).max)
        images = [one.image.reshape(*one.valid.shape, -1) / white for one in drawn]
        wanted, inside = resample(
            case.reference, case.affine, drawn[0].valid.shape, drawn[0].affine
        )
        wanted = wanted.reshape(images[0].shape)
        masks = _classes(case, wanted, inside, drawn[0])
        plain = [_psnr(images[0], wanted, mask) for mask in masks]
        gained = [
            _psnr(images[1], wanted, mask) - before
            for mask, before in zip(masks, plain, strict=True)
        ]
        ratio = float(np.nanmedian(depth.patch_size)) / pitch
        blur = choose_blur(case.camera, depth)
        disc = float(possible_discs(blur, np.array([ratio]))[1].mean())
        others = _baselines(images[0], disc * scale / (abs(ratio) * pitch))
        gained += [_psnr(other, wanted, masks[0]) - plain[0] for other in others]
        cells = ["" if np.isnan(gain) else f"{gain:+.2f}" for gain in gained]
        yield f"| {case.name} | {scale:.1f} | {plain[0]:.2f} | {' | '.join(cells)} |"


def _main() -> None:
    cases = truth_cases(Path(sys.argv[1])) if sys.argv[1:] else _simulated_cases()
    if len(sys.argv) > 2:
        first, end, *quality = map(int, sys.argv[1:])
        cases = (random_case(seed, *quality) for seed in range(first, end))
    columns = "scene", "pixels per pitch", "off [dB]", "natural", "edges", "blank", "border"
    print(f"| {' | '.join((*columns, 'Wiener', 'R.-L.', 'TV'))} |\n|{'---|' * 10}")
    for case in cases:
        for row in _rows(case):
            print(row, flush=True)


if __name__ == "__main__":
    _main()
