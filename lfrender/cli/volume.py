"""`lfrender volume`: the volume under a light-field microscope."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from lfcal.runtime.output_file import check_folder, make_folder

from .inputs import CaptureInput
from .options import capture_command, option_errors

if TYPE_CHECKING:
    from lfcal import Calibration

    from ..volume.volume import Volume

__all__ = ["volume"]


@capture_command(
    "volume",
    "lfrender volume flat.tif --white white.tif -o volume.ome.tif",
    "lfrender volume flat.tif -c camera.json -o volume.ome.zarr --na 0.5 --magnification 20 "
    "--microlens-focal-length 2433 --pixel-size 4.55 --depth-range -120 120",
    "lfrender volume flat.tif -c camera.json -o part.ome.tif --roi 400 300 900 700",
    "lfrender volume frames -c camera.json -o lapse.ome.tif --interval 0.1",
    output=(
        "VOLUME|FOLDER",
        "Volume to write: .ome.tif or .ome.zarr, with an axis of time for several flats; or a "
        "folder for a volume of each.",
    ),
    own={
        "Optics": "na magnification medium_index microlens_focal_length pixel_size wavelength",
        "Volume": "depth_range planes steps voxels",
        "Time lapse": "interval",
    },
    refused={
        "depth_file": "a volume holds all depths",
        "preset": "no depth map is analysed; --steps sets the time",
        "page": "of several pictures in a file, each becomes a volume",
    },
    inputs="the first flat",
    several="FLAT...",
)
def volume(capture: CaptureInput, given: Any) -> None:
    """Reconstruct the volume under a light-field microscope (experimental).

    FLAT is deconvolved on its own lattice. With the optics, the volume is in micrometres; without,
    in pixels of the flat and slopes k = -D / s. Of several flats, folders or videos, each starts
    from the volume before.
    """
    from .. import Microscope, reconstruct_volume
    from ..volume.files import SUFFIXES, check_volume_file, open_volume_file

    report = capture.report
    output = given.output
    one_file = output.suffix.lower() in SUFFIXES
    if one_file:
        check_volume_file(output)
    else:
        check_folder(output)
    with option_errors():
        optics = (field.name for field in fields(Microscope))
        microscope = Microscope(**{name: getattr(given, name) for name in optics})
        frames = capture.open_frames(given.inputs)
    if not one_file:
        make_folder(output)
    interval = given.interval
    if interval is None and frames.rate:
        interval = float(1 / frames.rate)
    collected: AbstractContextManager[Any] = nullcontext()
    if one_file:
        collected = open_volume_file(output, interval)
    written: list[str] = []
    found: Volume | None = None
    calibration: Calibration | None = None
    number = 0
    with collected as add:
        for number, frame in enumerate(frames, 1):
            pixels = frame.read()
            if calibration is None:
                pixels, calibration = capture.calibrate(pixels)
            name = f"volume {number}"
            with report.stage("reconstruct"), report.progress(name) as step, option_errors():
                found = reconstruct_volume(
                    pixels,
                    calibration,
                    microscope,
                    depth_range=given.depth_range,
                    planes=given.planes,
                    steps=given.steps,
                    voxels=given.voxels,
                    roi=capture.roi,
                    start=found,
                    progress=step,
                    check=False,
                )
            with report.stage("write"):
                if one_file:
                    add(found)
                else:
                    written.append(str(output / f"{frame.name}.ome.tif"))
                    found.save(written[-1])
    assert found is not None and calibration is not None
    if one_file:
        written.append(str(output))
    where = str(output)
    if number > 1:
        where = f"{number} volumes in {output}"
    fit = found.fit
    about = {
        "volume": written[0],
        "volumes": written,
        "frames": number,
        "shape": found.data.shape,
        "spacing": found.spacing,
        "unit": found.unit,
        "residual": fit.residual,
        "noise": fit.noise,
        "steps": fit.steps,
        "stopped": fit.reason,
        "warnings": found.warnings,
    }
    closing = f"{where}, in {report.took}."
    capture.conclude(about, calibration, None, _describe(found), closing)


def _describe(found: Volume) -> str:
    """Size of a volume, and how well it explains the flat, in two sentences."""
    deep, high, wide = found.data.shape
    first = found.depths[0]
    last = found.depths[-1]
    dz, _, dx = found.spacing
    if found.unit == "um":
        size = f"of {dx:.3g} x {dx:.3g} x {dz:.3g} um, from {first:.4g} to {last:.4g} um"
    else:
        size = f"of {dx:.3g} px, at slopes k = -D / s from {first:.3g} to {last:.3g}"
    fit = found.fit
    return (
        f"{wide} x {high} x {deep} voxels {size}. After {fit.steps} steps the residual is "
        f"{fit.residual:.1%} of the flat, its noise {fit.noise:.1%}: {fit.reason}."
    )
