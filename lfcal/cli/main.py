"""Command line of lfcal: calibrate a camera; show, compare, convert camera files."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from ..runtime import command_line as cl
from ..runtime.image_formats import MOSAICS, TIFF_SUFFIXES
from ..runtime.output_file import atomic_write, check_output
from .assess import assess
from .figures import describe, summarise
from .metric import board, metric

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..camera.calibration import Calibration

__all__ = ["main"]

_INPUT = cl.InputPath()
_SIZE = cl.Pair("WxH", "2048x1536")
_CAMERA = cl.option(
    "-o --output", cl.OutputPath(".json"), "Camera file to write.", "CAMERA.json", required=True
)
_SIZE_OPTIONS = (
    cl.option("--size", _SIZE, "Size of the flats [px], for files without it (.xml, .csv)."),
    cl.option("--image", _INPUT, "An image of that size, instead of --size."),
)
_FILES = (_CAMERA, cl.option("--dark", _INPUT, "Dark frame that is subtracted from the images."))
_KNOWN = (
    cl.option(
        "--kind",
        click.Choice(["auto", "white", "scene"]),
        "What the images show: an evenly lit white surface, or any scene.",
        default="auto",
        show_default=True,
    ),
    cl.option(
        "--mosaic",
        click.Choice(MOSAICS, case_sensitive=False),
        "Colour filters of the top left 2 x 2 pixels of a raw mosaic, row by row. By default it "
        "is detected.",
    ),
    cl.option(
        "--pitch", click.FloatRange(0, min_open=True), "Pitch, right to a tenth, as hint.", "PX"
    ),
    cl.option(
        "--rotation", float, "Beside --pitch: as 'lfcal info' prints it, to 2 degrees.", "DEGREES"
    ),
    cl.option(
        "--linear/--encoded",
        None,
        "Whether values are in proportion to light, or encoded "
        "for display. By "
        "default 8 bits and videos are taken as encoded.",
        default=None,
    ),
)
_READING = (
    cl.option(
        "--page",
        click.IntRange(0),
        "Which picture of a TIFF of several, or frame of a video, from 0.",
        "N",
    ),
    cl.option("--size", _SIZE, "Of raw video (.yuv), if its name does not have it."),
    cl.option("--pixel-format", str, "Of raw video: yuv420p10, yuv444p, ...", "FORMAT"),
)
_LATTICE = (
    cl.option("--size", _SIZE, "Size of the flats [px].", required=True),
    cl.option("--pitch", float, "Distance between neighbouring centres [px].", "PX", required=True),
    cl.option(
        "--arrangement",
        click.Choice(["hexagonal", "hexagonal-vertical", "square"]),
        "Of the microlenses; hexagonal ones in rows across, or down (vertical).",
        default="hexagonal",
        show_default=True,
    ),
    cl.option(
        "--rotation", float, "Clockwise on the screen [degrees].", default=0.0, show_default=True
    ),
    cl.option(
        "--centre", (float, float), "Of any microimage [px].  [default: middle of the flat]", "X Y"
    ),
    cl.option(
        "--radius", float, "Usable radius of the microimages [px].  [default: half the pitch]", "PX"
    ),
)


def _output(metavar: str, text: str) -> Any:
    return cl.option("-o --output", cl.OutputPath(), text, metavar, required=True)


def _write(report: cl.Report, camera: Calibration, output: Path, *lines: str) -> None:
    camera.save(output)
    report.finish({"camera": str(output), **describe(camera)}, *lines)


@cl.command(
    "lfcal calibrate white.png -o camera.json",
    "lfcal calibrate white1.png white2.png -o camera.json",
    "lfcal calibrate scene.tif --kind scene --mosaic rggb -o camera.json",
    "lfcal calibrate scene.tif --pitch 15.4 --dark dark.tif -o camera.json",
)
@cl.several_inputs("images", "IMAGE...")
@cloup.option_group("Files", *_FILES)
@cloup.option_group("What is known", *_KNOWN)
@cloup.option_group("Reading IMAGE", *_READING)
@cl.report_options
def calibrate(report: cl.Report, given: Any) -> None:
    """Find the microlenses on IMAGE and write them as a camera file.

    IMAGE is a white image, or any capture of a scene. Several white images, or several captures of
    one camera, are combined.
    """
    images = given.images
    output = given.output
    check_output(output, {".json"}, [*images, given.dark])
    if given.rotation is not None and given.pitch is None:
        raise click.UsageError("--rotation needs --pitch")
    with report.stage("read"):
        from .. import calibrate as run
        from .. import read_flat, subtract_dark

        flats = [
            read_flat(path, given.page, size=given.size, pixel_format=given.pixel_format)
            for path in images
        ]
        if given.dark is not None:
            frame = read_flat(given.dark)
            with cl.name_file_in_errors(given.dark):
                flats = [subtract_dark(flat, frame) for flat in flats]
    named = str(images[0])
    if len(images) > 1:
        named += " ..."
    with report.stage("calibrate"), cl.name_file_in_errors(named):
        camera = run(
            flats if len(flats) > 1 else flats[0],
            given.kind,
            given.mosaic,
            given.pitch,
            given.rotation,
        )
        if given.linear is not None:
            camera = replace(camera, encoded=not given.linear)
    _write(report, camera, output, *summarise(camera), f"{output} in {report.took}.")


@cl.command(
    "lfcal lattice --size 2048x1536 --pitch 15.41 --arrangement square -o camera.json",
    "lfcal lattice --size 2048x2048 --pitch 23.2 --centre 1019.8 1031.2 -o camera.json",
)
@cl.with_options(*_LATTICE, _CAMERA)
@cl.report_options
def lattice(report: cl.Report, given: Any) -> None:
    """State the lattice of a camera that no flat shows well enough.

    The light of the microimages stays unknown. Commands that use the file check it against the
    flat.
    """
    output = given.output
    check_output(output, {".json"})
    from ..camera.calibration import Calibration
    from ..lattice.stated import state_lattice

    try:
        stated = state_lattice(
            given.size, given.pitch, given.arrangement, given.rotation, given.centre, given.radius
        )
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    warning = "the lattice was stated, not measured"
    camera = Calibration(stated, source="published", confidence=1.0, warnings=(warning,))
    _write(
        report,
        camera,
        output,
        summarise(camera)[0],
        f"{output} is written; check it with 'lfcal show'.",
    )


@cl.command("lfcal info camera.json", "lfcal info calibration.xml --image flat.png")
@click.argument("camera", type=_INPUT)
@cl.with_options(*_SIZE_OPTIONS)
@cl.report_options
def info(report: cl.Report, given: Any) -> None:
    """Show what is in the camera file CAMERA."""
    report.finish({"camera": str(given.camera), **describe(_read(given.camera, _read_size(given)))})


@cl.command("lfcal show camera.json --image white.png -o show.png")
@click.argument("camera", type=_INPUT)
@cl.option("--image", _INPUT, "A white image or scene capture of that camera.", required=True)
@_output("SHOW.png", "Picture to write.")
@cl.report_options
def show(report: cl.Report, given: Any) -> None:
    """Draw the circles of CAMERA over the centre and the corners of an image."""
    output = given.output
    check_output(output, {".png"}, [given.camera, given.image])
    with report.stage("read"):
        from .. import check_camera, read_flat
        from .. import show as run
        from ..display.overlay import find_places_to_check

        flat = read_flat(given.image)
        camera = _read(given.camera, (flat.shape[1], flat.shape[0]))
    with report.stage("show"):
        pixels = run(camera, flat)
        look = [place.sentence for place in find_places_to_check(camera, flat)]
        # What does not fit at all is drawn too: that is what to look for.
        if (problem := check_camera(camera, flat).problem) is not None:
            camera = replace(camera, warnings=(*camera.warnings, problem))
    with report.stage("write"), atomic_write(output) as temporary:
        from PIL import Image

        Image.fromarray(pixels).save(temporary, compress_level=4)
    lines = (
        *(f"look: {words}" for words in look),
        f"{output}: the circles should lie on the microimages.",
    )
    report.finish(
        {"picture": str(output), **describe(camera), "look_at": look}, *summarise(camera), *lines
    )


@cl.command("lfcal flatten flat.png -c camera.json -o even.tif")
@click.argument("flat", type=_INPUT)
@cl.option("-c --camera", _INPUT, "Camera file with a gain map.", required=True)
@_output("FLAT.tif", "Flattened flat to write.")
@cl.report_options
def flatten(report: cl.Report, given: Any) -> None:
    """Light the microimages of FLAT evenly, by the gain map of CAMERA.

    Pixels are divided by their gain; those of unknown gain stay.
    """
    output = given.output
    check_output(output, TIFF_SUFFIXES, [given.flat, given.camera])
    with report.stage("read"):
        from .. import check_camera, read_flat

        pixels = read_flat(given.flat)
        height, width = pixels.shape[:2]
        camera = _read(given.camera, (width, height))
    with report.stage("flatten"), cl.name_file_in_errors(given.flat):
        even = camera.flatten(pixels)
        warnings = check_camera(camera, pixels).warn(camera, given.camera).warnings
    with report.stage("write"), atomic_write(output) as temporary:
        import tifffile

        tifffile.imwrite(temporary, even, photometric="rgb" if even.ndim == 3 else "minisblack")
    figures = {
        "written": str(output),
        "size": [width, height],
        "type": str(even.dtype),
        "warnings": warnings,
    }
    report.finish(
        figures, f"{output}: {width} x {height} px of {even.dtype}, evenly lit, in {report.took}."
    )


@cl.command("lfcal compare monday.json friday.json")
@click.argument("a", type=_INPUT)
@click.argument("b", type=_INPUT)
@cl.with_options(*_SIZE_OPTIONS)
@cl.report_options
def compare(report: cl.Report, given: Any) -> None:
    """Tell how the microimage centres of cameras A and B differ.

    All differences are B minus A, in pixels.
    """
    from .. import CameraFileError, load
    from .. import compare as run
    from ..display.compare import REGIONS

    paths = (given.a, given.b)
    size = _read_size(given)
    for path in paths:
        # A published file has none.
        with suppress(CameraFileError):
            size = size or load(path).image_size
    cameras = [_read(path, size) for path in paths]
    found = run(*cameras)
    field = dict(zip(REGIONS, found.field.reshape(-1, 2).round(6), strict=True))
    warnings = [
        f"{path}: {text}"
        for path, camera in zip(paths, cameras, strict=True)
        for text in camera.warnings
    ]
    report.finish(
        {
            "a": str(given.a),
            "b": str(given.b),
            "rms": round(found.rms, 6),
            "max": round(found.max, 6),
            "mean_shift": found.mean_shift.round(6),
            "scale": round(found.scale, 9),
            "rotation_degrees": round(found.rotation_degrees, 7),
            "field": field,
            "warnings": warnings,
        }
    )


@cl.command(
    "lfcal convert camera.json -o calibration.xml",
    "lfcal convert calibration.xml --image flat.png -o camera.json",
    "lfcal convert camera.json --image flat.png -o camera.cfg",
    "lfcal convert centres.csv --image white.png -o camera.json",
)
@click.argument("camera", type=_INPUT)
@_output("FILE", ".xml, .cfg, .csv or .json to write.")
@cl.option(
    "--mode",
    click.Choice(["telescopic", "binocular"]),
    "Mode of the captures, for a .cfg file.  [default: that of --image or of the lens types]",
)
@cl.option(
    "--y-up/--y-down",
    None,
    "Where y of a table of centres points.  [default: as --image shows, else down]",
    default=None,
)
@cl.with_options(*_SIZE_OPTIONS)
@cl.report_options
def convert(report: cl.Report, given: Any) -> None:
    """Write CAMERA in the format of another program, or the reverse.

    The suffix of the output chooses the format. CAMERA may be a maker's table of centres: lines of
    x, y, radius and type, or with a header that names the columns.
    """
    from ..camera_files.read_write import FORMATS
    from ..camera_files.read_write import convert as run

    output = given.output
    image = given.image
    mode = given.mode
    check_output(output, FORMATS, [given.camera, image])
    pixels = given.image and _read_image(given)
    size = given.size if pixels is None else pixels.shape[1::-1]
    camera = _read(given.camera, size)
    up = _read(given.camera, size, True)
    told = ""
    if camera == up and given.y_up is not None:
        raise click.UsageError("--y-up and --y-down are for tables of centres")
    if camera != up and given.y_up is None and pixels is not None:
        from ..display.camera_check import choose_orientation

        camera = choose_orientation(camera, up, pixels)
    elif camera != up and given.y_up is None:
        told = "; y was taken to point down: --image shows whether it does"
    elif given.y_up:
        camera = up
    if mode is None and pixels is not None and output.suffix.lower() == ".cfg":
        from ..lens_types.coarse_disparity import find_scene_mode

        mode = find_scene_mode(pixels, camera.lattice)
    run(camera, output, mode=mode)
    if camera.source == "published" and camera.lenses_used:
        told = f", {camera.residual_rms:.3f} px (RMS) from the centres of the table{told}"
    report.finish(
        {"written": str(output), **describe(camera)},
        *summarise(camera),
        f"{output} is written{told}.",
    )


def _read_image(given: Any) -> NDArray[Any]:
    if given.size is not None:
        raise click.UsageError("--size and --image exclude each other")
    from .. import read_flat

    return read_flat(given.image)


def _read_size(given: Any) -> tuple[int, int] | None:
    size: tuple[int, int] | None = given.size
    if given.image is not None:
        size = _read_image(given).shape[1::-1]
    return size


def _read(path: Path, size: tuple[int, int] | None, y_up: bool = False) -> Calibration:
    """A camera file of any format; an error about its missing size names the options for it."""
    from .. import CameraFileError, load

    try:
        return load(path, size, y_up=y_up)
    except CameraFileError as error:
        if size is None and "image_size" in str(error):
            raise CameraFileError(
                f"{path}: has no image size; add --size WxH or --image"
            ) from error
        raise


@cloup.group(
    cls=cl.Program,
    name="lfcal",
    context_settings={"help_option_names": ["-h", "--help"]},
    others=(
        "lfrender",
        "analyze batch demo lenslet live refocus render report view views volume warm",
    ),
)
@click.version_option(package_name="lfrender", prog_name="lfcal")
def main() -> None:
    """Find the microimages of a focused plenoptic camera, and write them as a camera file."""


main.section("Calibrate a camera", calibrate, lattice)
main.section("Look at camera files", info, show, compare, assess)
main.section("Use them elsewhere", convert, flatten)
main.section("Measure in metres", board, metric)


if __name__ == "__main__":
    main()
