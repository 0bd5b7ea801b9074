"""The demo: a simulated capture, its pictures, and their errors against the truth."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from data_synth import SCENES, Camera, Capture, simulate
from data_synth.metrics import (
    centre_error,
    compare_pictures,
    magnification_error,
    mode_accuracy,
    resample,
)
from lfcal import Calibration, calibrate
from lfcal.runtime.command_line import Report
from lfcal.runtime.output_file import make_folder

from .. import analyze
from ..data.depth_map import DepthMap
from ..data.rendering import Rendering
from ..data.samples import SENSOR_NOISE
from ..flat.lens_graph import nearest_lens
from ..output.depth_picture import lens_maps
from ..output.picture import write_picture
from .report import write_report
from .report_pictures import ReportPictures, data_urls, draw_pictures, picture_url
from .templates import fill

__all__ = ["run_demo"]

# The simulated camera; the lattice is turned a little, as real ones are [degrees].
_CAMERA: dict[str, Any] = {"pitch": 23.2, "lattice": "hex", "rotation": 0.7}
# Width and height of the crop of the flat on the page [px], and its place, as shares of those of the
# flat: there both modes meet.
_CROP = (320, 240)
_CROP_PLACE = (0.6, 0.24)
# Room for the true picture on the page [characters].
_REFERENCE_BYTES = 2_000_000


def run_demo(
    folder: str | os.PathLike[str],
    report: Report | None = None,
    *,
    flat_size: tuple[int, int] = (1600, 1200),
    samples: int = 16,
) -> dict[str, Any]:
    """Simulate the scene `house`, calibrate, analyse and render it, and write a page.

    Only the flat is used; the white image is calibrated as well, for comparison. The folder is made
    if it does not exist, files of the same names in it are replaced; OutputError if it cannot be
    written. `report` gets the stages and their seconds; `flat_size` is width and height [px],
    `samples` are rays per pixel and microlens. Returns the figures on the page, as plain numbers.
    """
    target = make_folder(folder, parents=True)
    report = report or Report(quiet=True)
    with report.stage("simulate"):
        camera = Camera.design(flat_size, **_CAMERA)
        scene = SCENES["house"](camera)
        capture = simulate(scene, camera, samples=samples, seed=1, noise=SENSOR_NOISE)
    flat = capture.flat
    truth = capture.truth
    with report.stage("calibrate from the capture"):
        from_scene = calibrate(flat, kind="scene")
    with report.stage("calibrate from the white image"):
        from_white = calibrate(capture.white, kind="white")
    with report.stage("analyze"):
        depth = analyze(flat, from_scene, check=False)
    with report.stage("render"):
        pictures = draw_pictures(flat, from_scene, depth)
    with report.stage("compare with the truth"):
        sharp = pictures.sharp
        reference, _ = resample(
            truth.reference, truth.reference_affine, sharp.image.shape[:2], sharp.affine
        )
        figures = _measure(capture, {"scene": from_scene, "white": from_white}, depth, pictures)
    with report.stage("write"):
        true_picture = np.rint(reference * np.iinfo(flat.dtype).max).astype(flat.dtype)
        x, y = (int(share * n) for share, n in zip(_CROP_PLACE, flat.shape[1::-1], strict=True))
        crop = flat[y : y + _CROP[1], x : x + _CROP[0]]
        maps = lens_maps(depth, from_scene.lattice, sharp.affine, sharp.image.shape[:2])
        written = {
            "flat": flat,
            "flat_crop": crop,
            "traditional": pictures.traditional,
            **pictures.fixed,
            "all_in_focus": sharp,
            "reference": true_picture,
            "depth": maps["depth"],
            "modes": maps["modes"],
        }
        for name, picture in written.items():
            write_picture(target / f"{name}.png", picture)
    figures = {**figures, "seconds": report.seconds}
    urls, _ = data_urls({"reference": true_picture}, _REFERENCE_BYTES)
    quality = figures["merit"]
    best_fixed = max(quality[name]["psnr"] for name in pictures.fixed)
    section = fill(
        "demo.html",
        flat_crop=picture_url(crop, ".png"),
        reference=urls["reference"],
        figures=figures,
        better=quality["all_in_focus"]["psnr"] - best_fixed,
    )
    # Those that a user's own capture would take: without the simulation, its truth, and its white
    # image.
    stages = {"calibrate": "calibrate from the capture", "analyze": "analyze", "render": "render"}
    write_report(
        target / "index.html",
        flat,
        from_scene,
        depth,
        pictures,
        title="One capture, both modes, sharp everywhere",
        seconds={name: report.seconds[stage] for name, stage in stages.items()},
        compare={"truth": true_picture},
        further=section,
        command="lfrender demo",
    )
    return {"page": str(target / "index.html"), **figures}


def _measure(
    capture: Capture, cameras: Mapping[str, Calibration], depth: DepthMap, pictures: ReportPictures
) -> dict[str, Any]:
    """All errors against the truth."""
    truth = capture.truth
    sharp = pictures.sharp
    true_lattice = truth.calibration.lattice
    resolvable = truth.mode != 0
    selections = {"all": resolvable, "one_depth": resolvable & ~truth.mixed}
    lens = nearest_lens(cameras["scene"].lattice.centres(), true_lattice.centres())
    mode = np.asarray(depth.mode)[lens]
    size = np.asarray(depth.patch_size)[lens]
    errors = {
        "mode_right": lambda where: mode_accuracy(mode, truth.mode, where),
        "mode_wrong": lambda where: mode_accuracy(-mode, truth.mode, where),
        "magnification_error": lambda where: magnification_error(size, truth.patch_size, where),
    }
    return {
        "flat_size": list(truth.calibration.image_size),
        "pitch": true_lattice.pitch,
        "lenses": len(true_lattice),
        "lenses_judged": int(resolvable.sum()),
        "calibration": {
            kind: {
                "centre_error": centre_error(c.lattice, true_lattice),
                "confidence": float(c.confidence),
            }
            for kind, c in cameras.items()
        },
        **{
            key: {name: error(where) for name, where in selections.items()}
            for key, error in errors.items()
        },
        "merit": {
            name: _compare(capture, picture)
            for name, picture in {"all_in_focus": sharp, **pictures.fixed}.items()
        },
        "fixed_patch_size": dict(pictures.patch_size),
        "picture_size": list(sharp.image.shape[1::-1]),
        "scale": sharp.scale,
        "warnings": list(cameras["scene"].warnings),
    }


def _compare(capture: Capture, picture: Rendering, resolvable: float = 0.75) -> dict[str, float]:
    """PSNR and SSIM over pixels with `|s| / D` up to `resolvable`."""
    truth = capture.truth
    shape = picture.image.shape[:2]
    reference, inside = resample(truth.reference, truth.reference_affine, shape, picture.affine)
    ratio = (
        np.nan_to_num(np.abs(truth.reference_patch_size), nan=np.inf)
        / truth.calibration.lattice.pitch
    )
    unresolvable, _ = resample(
        (ratio > resolvable).astype(np.float64), truth.reference_affine, shape, picture.affine
    )
    quality = compare_pictures(
        picture.image, reference, inside & np.asarray(picture.valid) & (unresolvable < 1e-6)
    )
    return {"psnr": quality.psnr, "ssim": quality.ssim}
