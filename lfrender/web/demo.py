"""The demo: simulate a capture, run the whole chain on nothing but its pixels, compare with the truth."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_synth import SCENES, Camera, Capture, simulate
from lfcal import Calibration, OutputError, calibrate
from lfcal.runtime.console import Report

from .. import analyze
from ..data.depth_map import DepthMap
from ..data.rendering import Rendering
from ..flat.lens_graph import nearest_lens
from ..output.depth_picture import magnification_picture, mode_picture
from ..output.metrics import (
    centre_error,
    compare_pictures,
    magnification_error,
    mode_accuracy,
    resample,
)
from ..output.picture import write_picture
from .demo_page import truth_section
from .report import write_report
from .report_pictures import ReportPictures, data_urls, draw_pictures, png_url

__all__ = ["run_demo"]

_FLAT_SIZE = (1600, 1200)
_PITCH = 23.2
_ROTATION = 0.7
_SAMPLES = 32
_NOISE = (9000.0, 5.0)
# Beyond this share of D neighbouring microimages share too little for any method.
_RESOLVABLE = 0.75
_CROP = (320, 240)
# For the truth on the page [characters].
_ROOM = 2_000_000


@dataclass(frozen=True)
class _Results:
    """What the chain made of the capture."""

    from_scene: Calibration
    from_white: Calibration
    depth: DepthMap
    pictures: ReportPictures


def run_demo(
    folder: str | os.PathLike[str],
    report: Report | None = None,
    *,
    flat_size: tuple[int, int] = _FLAT_SIZE,
    samples: int = _SAMPLES,
    seed: int = 1,
) -> dict[str, Any]:
    """Simulate the scene `house`, calibrate, analyse and render it, and write pictures and an HTML page.

    The chain sees the flat only; the white image is calibrated as well, for comparison.

    Parameters
    ----------
    folder : path-like
        Made if it does not exist. Files of the same names in it are replaced.
    report : Report, optional
        Gets the stages and their seconds.
    flat_size : (int, int) [px]
        Width and height of the simulated flat.
    samples : int
        Rays per pixel and microlens.
    seed : int
        Of the simulation.

    Returns
    -------
    dict
        The figures on the page, as plain numbers.

    Raises
    ------
    OutputError
        If the folder cannot be made or written.
    """
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{target}: cannot be made ({error.strerror})") from error
    report = report or Report(quiet=True)
    report.announce_compilation("data_synth", "lfcal", "lfrender")
    with report.stage("simulate"):
        camera = Camera.design(flat_size, _PITCH, "hex", _ROTATION)
        capture = simulate(SCENES["house"](camera), camera, samples=samples, seed=seed, noise=_NOISE)
    results = _run_chain(capture, report)
    with report.stage("compare with the truth"):
        figures, reference = _measure(capture, results)
    white = np.iinfo(capture.flat.dtype).max
    truth = np.rint(reference * white).astype(capture.flat.dtype)
    with report.stage("write"):
        crop = _crop_where_modes_meet(capture)
        _write_pictures(target, capture, results, truth, crop)
    figures = {**figures, "seconds": report.seconds}
    urls, _ = data_urls({"reference": truth}, _ROOM)
    write_report(
        target / "index.html", capture.flat, results.from_scene, results.depth, results.pictures,
        title="One capture, both modes, sharp everywhere", seconds=report.seconds, compare={"truth": truth},
        further=truth_section(figures, png_url(crop), urls["reference"]), command="lfrender demo",
    )  # fmt: skip
    return {"page": str(target / "index.html"), **figures}


def _run_chain(capture: Capture, report: Report) -> _Results:
    flat = capture.flat
    with report.stage("calibrate from the capture"):
        from_scene = calibrate(flat, kind="scene")
    with report.stage("calibrate from the white image"):
        from_white = calibrate(capture.white, kind="white")
    with report.stage("analyze"):
        depth = analyze(flat, from_scene)
    with report.stage("render"):
        pictures = draw_pictures(flat, from_scene, depth)
    return _Results(from_scene, from_white, depth, pictures)


def _measure(capture: Capture, results: _Results) -> tuple[dict[str, Any], NDArray[Any]]:
    """All figures of merit, and the reference on the grid of the all-in-focus picture."""
    truth, lattice, sharp = capture.truth, results.from_scene.lattice, results.pictures.sharp
    true_lattice = truth.calibration.lattice
    resolvable = truth.mode != 0
    one_depth = resolvable & ~truth.mixed
    lens = nearest_lens(lattice, true_lattice.centres())
    mode, size = np.asarray(results.depth.mode)[lens], np.asarray(results.depth.patch_size)[lens]
    merit = {
        name: _compare(capture, picture) for name, picture in {"all_in_focus": sharp, **results.pictures.fixed}.items()
    }
    reference, _ = resample(truth.reference, truth.reference_affine, sharp.image.shape[:2], sharp.affine)
    figures = {
        "flat_size": list(truth.calibration.image_size),
        "pitch": true_lattice.pitch,
        "lenses": len(true_lattice),
        "lenses_judged": int(resolvable.sum()),
        "calibration": {
            kind: {"centre_error": centre_error(c.lattice, true_lattice), "confidence": float(c.confidence)}
            for kind, c in (("scene", results.from_scene), ("white", results.from_white))
        },
        "mode_right": {
            "all": mode_accuracy(mode, truth.mode, resolvable),
            "one_depth": mode_accuracy(mode, truth.mode, one_depth),
        },
        "mode_wrong": {
            "all": mode_accuracy(-mode, truth.mode, resolvable),
            "one_depth": mode_accuracy(-mode, truth.mode, one_depth),
        },
        "magnification_error": {
            "all": magnification_error(size, truth.patch_size, resolvable),
            "one_depth": magnification_error(size, truth.patch_size, one_depth),
        },
        "merit": merit,
        "fixed_patch_size": dict(results.pictures.patch_size),
        "picture_size": list(sharp.image.shape[1::-1]),
        "scale": sharp.scale,
        "warnings": list(results.from_scene.warnings),
    }
    return figures, reference


def _compare(capture: Capture, picture: Rendering) -> dict[str, float]:
    """PSNR and SSIM over the pixels whose depth any method could resolve."""
    truth, shape = capture.truth, picture.image.shape[:2]
    reference, inside = resample(truth.reference, truth.reference_affine, shape, picture.affine)
    ratio = np.nan_to_num(np.abs(truth.reference_patch_size), nan=np.inf) / truth.calibration.lattice.pitch
    unresolvable, _ = resample((ratio > _RESOLVABLE).astype(np.float64), truth.reference_affine, shape, picture.affine)
    merit = compare_pictures(picture.image, reference, inside & np.asarray(picture.valid) & (unresolvable < 1e-6))
    return {"psnr": merit.psnr, "ssim": merit.ssim}


def _write_pictures(
    folder: Path, capture: Capture, results: _Results, reference: NDArray[Any], crop: NDArray[Any]
) -> None:
    """Write all pictures as PNG files."""
    lattice, depth, sharp = results.from_scene.lattice, results.depth, results.pictures.sharp
    shape = sharp.image.shape[:2]
    pictures: Mapping[str, Any] = {
        "flat": capture.flat,
        "flat_crop": crop,
        "traditional": results.pictures.traditional,
        **results.pictures.fixed,
        "all_in_focus": sharp,
        "reference": reference,
        "magnification": magnification_picture(depth.patch_size, depth.mode, lattice, sharp.affine, shape),
        "modes": mode_picture(depth.mode, lattice, sharp.affine, shape),
    }
    for name, picture in pictures.items():
        write_picture(folder / f"{name}.png", picture)


def _crop_where_modes_meet(capture: Capture) -> NDArray[Any]:
    """The part of the flat that shows both modes most evenly."""
    sign = np.nan_to_num(np.sign(capture.truth.disparity))
    height, width = sign.shape
    w, h = min(_CROP[0], width), min(_CROP[1], height)
    windows = [
        np.s_[y : y + h, x : x + w]
        for y in range(0, height - h + 1, h // 2 or 1)
        for x in range(0, width - w + 1, w // 2 or 1)
    ]
    balance = [min(np.mean(sign[window] > 0), np.mean(sign[window] < 0)) for window in windows]
    return np.ascontiguousarray(capture.flat[windows[int(np.argmax(balance))]])
