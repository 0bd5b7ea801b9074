"""Command line of lfcal: calibrate a camera from images; show, compare, convert and apply camera files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
import cloup

from ..runtime import console
from ..runtime.image_formats import MOSAICS, TIFF_SUFFIXES, Mosaic
from ..runtime.output_file import atomic_write, check_output
from .figures import describe, summarise
from .lattice import lattice
from .metric import board, metric

if TYPE_CHECKING:
    from ..camera.calibration import Calibration

__all__ = ["main"]

_INPUT, _OUTPUT, _CAMERA = console.InputPath(), console.OutputPath(), console.OutputPath(".json")
# Commands that users look for here.
_LFRENDER_COMMANDS = "analyze", "batch", "demo", "refocus", "render", "report", "view", "views", "warm"


@console.command(
    "lfcal calibrate white.png -o camera.json",
    "lfcal calibrate white1.png white2.png -o camera.json",
    "lfcal calibrate scene.tif --kind scene --mosaic rggb -o camera.json",
    "lfcal calibrate scene.tif --pitch 15.4 --dark dark.tif -o camera.json",
)
@console.several_inputs("images", "IMAGE...")
@console.grouped(
    "Files",
    click.option("-o", "--output", type=_CAMERA, required=True, metavar="CAMERA.json", help="Camera file to write."),
    click.option("--dark", type=_INPUT, help="Dark frame that is subtracted from the images."),
)
@console.grouped(
    "What is known",
    click.option(
        "--kind",
        type=click.Choice(["auto", "white", "scene"]),
        default="auto",
        show_default=True,
        help="What the images show: an evenly lit white surface, or any scene.",
    ),
    click.option(
        "--mosaic",
        type=click.Choice(MOSAICS, case_sensitive=False),
        help="Colour filters of the top left 2 x 2 pixels of a raw mosaic, row by row. By default it is detected.",
    ),
    click.option(
        "--pitch", type=click.FloatRange(0, min_open=True), metavar="PX", help="Pitch, right to a tenth, as hint."
    ),
    click.option(
        "--rotation", type=float, metavar="DEGREES", help="Beside --pitch: as 'lfcal info' prints it, to 2 degrees."
    ),
    click.option(
        "--linear/--encoded",
        default=None,
        help="Whether values are in proportion to light, or encoded for display. By default 8 bits and videos are "
        "taken as encoded.",
    ),
)
@console.grouped("Reading IMAGE", console.page_option, console.raw_video_options)
@console.report_options
def calibrate(
    images: tuple[Path, ...],
    output: Path,
    kind: Literal["auto", "white", "scene"],
    mosaic: Mosaic | None,
    pitch: float | None,
    rotation: float | None,
    linear: bool | None,
    dark: Path | None,
    page: int | None,
    size: tuple[int, int] | None,
    pixel_format: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Find the microlenses on IMAGE and write them as a camera file.

    IMAGE is a white image, or any capture of a scene. Several white images, or several captures of one camera, are
    combined.
    """
    report = console.Report(as_json, quiet)
    check_output(output, {".json"}, [*images, dark])
    if rotation is not None and pitch is None:
        raise click.UsageError("--rotation needs --pitch")
    with report.stage("read"):
        from .. import FlatError, read_flat
        from .. import calibrate as run

        flats = [read_flat(image, page, size=size, pixel_format=pixel_format) for image in images]
        if dark is not None:
            from .. import subtract_dark

            frame = read_flat(dark)
            with console.name_file_in_errors(dark):
                flats = [subtract_dark(flat, frame) for flat in flats]
        for image, flat in zip(images, flats, strict=True):
            if flat.shape[:2] != flats[0].shape[:2]:
                raise FlatError(
                    f"{image}: is {flat.shape[1]} x {flat.shape[0]} px, {images[0]} is {flats[0].shape[1]} x "
                    f"{flats[0].shape[0]} px; give flats of one camera"
                )
    with report.stage("calibrate"), console.name_file_in_errors(images[0] if len(images) == 1 else f"{images[0]} ..."):
        camera = run(flats if len(flats) > 1 else flats[0], kind, mosaic, pitch, rotation)
        camera = camera if linear is None else replace(camera, encoded=not linear)
    camera.save(output)
    report.finish({"camera": str(output), **describe(camera)}, *summarise(camera), f"{output} in {report.took}.")


def _size_options(command: Any) -> Any:
    """Give a command the options for the size of the flats of a published file."""
    command = click.option("--image", type=_INPUT, help="An image of that size, instead of --size.")(command)
    return click.option("--size", metavar="WxH", help="Size of the flats [px], for files without it (.xml, .csv).")(
        command
    )


@console.command("lfcal info camera.json", "lfcal info calibration.xml --image flat.png")
@click.argument("camera", type=_INPUT)
@_size_options
@console.report_options
def info(camera: Path, size: str | None, image: Path | None, as_json: bool, quiet: bool) -> None:
    """Show what is in the camera file CAMERA."""
    calibration = _read(camera, _read_size(size, image))
    console.Report(as_json, quiet).finish({"camera": str(camera), **describe(calibration)})


@console.command("lfcal show camera.json --image white.png -o show.png")
@click.argument("camera", type=_INPUT)
@click.option("--image", type=_INPUT, required=True, help="A white image or scene capture of that camera.")
@click.option("-o", "--output", type=_OUTPUT, required=True, metavar="SHOW.png", help="Picture to write.")
@console.report_options
def show(camera: Path, image: Path, output: Path, as_json: bool, quiet: bool) -> None:
    """Draw the circles of CAMERA over the centre and the corners of an image."""
    report = console.Report(as_json, quiet)
    check_output(output, {".png"}, [camera, image])
    with report.stage("read"):
        from .. import read_flat

        flat = read_flat(image)
        calibration = _read(camera, (flat.shape[1], flat.shape[0]))
    with report.stage("show"):
        from PIL import Image

        from .. import check_camera
        from .. import show as run
        from ..display.overlay import find_places_to_check

        picture = Image.fromarray(run(calibration, flat))
        places = find_places_to_check(calibration, flat)
        check = check_camera(calibration, flat)
        # What does not fit at all is drawn too: that is what to look for.
        if (problem := check.problem) is not None:
            calibration = replace(calibration, warnings=(*calibration.warnings, problem))
    with report.stage("write"), atomic_write(output) as temporary:
        picture.save(temporary, compress_level=4)
    look = [place.sentence for place in places]
    figures = {"picture": str(output), **describe(calibration), "look_at": look}
    lines = (*(f"look: {words}" for words in look), f"{output}: the circles should lie on the microimages.")
    report.finish(figures, *summarise(calibration), *lines)


@console.command("lfcal flatten flat.png -c camera.json -o even.tif")
@click.argument("flat", type=_INPUT)
@click.option("-c", "--camera", type=_INPUT, required=True, help="Camera file with a gain map.")
@click.option("-o", "--output", type=_OUTPUT, required=True, metavar="FLAT.tif", help="Flattened flat to write.")
@console.report_options
def flatten(flat: Path, camera: Path, output: Path, as_json: bool, quiet: bool) -> None:
    """Light the microimages of FLAT evenly, by the gain map of CAMERA.

    Pixels are divided by their gain; those of unknown gain stay.
    """
    report = console.Report(as_json, quiet)
    check_output(output, TIFF_SUFFIXES, [flat, camera])
    with report.stage("read"):
        from .. import read_flat

        pixels = read_flat(flat)
        calibration = _read(camera, (pixels.shape[1], pixels.shape[0]))
    with report.stage("flatten"), console.name_file_in_errors(flat):
        from .. import check_camera

        even = calibration.flatten(pixels)
        warnings = check_camera(calibration, pixels).warn(calibration, camera).warnings
    with report.stage("write"), atomic_write(output) as temporary:
        import tifffile

        tifffile.imwrite(temporary, even, photometric="rgb" if even.ndim == 3 else "minisblack")
    report.finish(
        {
            "written": str(output),
            "size": [even.shape[1], even.shape[0]],
            "type": str(even.dtype),
            "warnings": list(warnings),
        },
        f"{output}: {even.shape[1]} x {even.shape[0]} px of {even.dtype}, evenly lit, in {report.took}.",
    )


@console.command("lfcal compare monday.json friday.json")
@click.argument("a", type=_INPUT)
@click.argument("b", type=_INPUT)
@_size_options
@console.report_options
def compare(a: Path, b: Path, size: str | None, image: Path | None, as_json: bool, quiet: bool) -> None:
    """Tell how the microimage centres of cameras A and B differ.

    All differences are B minus A, in pixels.
    """
    from .. import compare as run

    first, second = _read_pair(a, b, _read_size(size, image))
    difference = run(first, second)
    figures = {
        "rms": round(difference.rms, 6),
        "max": round(difference.max, 6),
        "mean_shift": difference.mean_shift.round(6),
        "scale": round(difference.scale, 9),
        "rotation_degrees": round(difference.rotation_degrees, 7),
    }
    names = [f"{row} {column}" for row in ("top", "middle", "bottom") for column in ("left", "centre", "right")]
    field = dict(zip(names, difference.field.reshape(-1, 2).round(6), strict=True))
    warnings = [f"{path}: {w}" for path, camera in ((a, first), (b, second)) for w in camera.warnings]
    console.Report(as_json, quiet).finish({"a": str(a), "b": str(b), **figures, "field": field, "warnings": warnings})


@console.command(
    "lfcal convert camera.json -o calibration.xml",
    "lfcal convert calibration.xml --image flat.png -o camera.json",
    "lfcal convert camera.json --image flat.png -o camera.cfg",
)
@click.argument("camera", type=_INPUT)
@click.option("-o", "--output", type=_OUTPUT, required=True, metavar="FILE", help=".xml, .cfg, .csv or .json to write.")
@click.option(
    "--mode",
    type=click.Choice(["telescopic", "binocular"]),
    help="Of the captures, which a .cfg file states.  [default: as --image, or the focus of the lens types]",
)
@_size_options
@console.report_options
def convert(
    camera: Path,
    output: Path,
    mode: Literal["telescopic", "binocular"] | None,
    size: str | None,
    image: Path | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Write CAMERA in the format of another program, or the reverse.

    The suffix of the output chooses the format.
    """
    from ..camera_files.read_write import FORMATS
    from ..camera_files.read_write import convert as run

    check_output(output, FORMATS, [camera, image])
    calibration = _read(camera, _read_size(size, image))
    if mode is None and image is not None and output.suffix.lower() == ".cfg":
        from .. import read_flat
        from ..lens_types.scene_mode import find_scene_mode

        mode = find_scene_mode(read_flat(image), calibration.lattice)
    run(calibration, output, mode=mode)
    figures = {"written": str(output), **describe(calibration)}
    console.Report(as_json, quiet).finish(figures, *summarise(calibration), f"{output} is written.")


def _read_size(size: str | None, image: Path | None) -> tuple[int, int] | None:
    """Width and height [px] from `--size` or `--image`, None without either."""
    if size is not None and image is not None:
        raise click.UsageError("--size and --image exclude each other")
    if image is not None:
        from .. import read_flat

        height, width = read_flat(image).shape[:2]
        return width, height
    if size is None:
        return None
    width_text, _, height_text = size.lower().partition("x")
    try:
        width, height = int(width_text), int(height_text)
    except ValueError:
        width = height = 0
    if width < 1 or height < 1:
        raise click.UsageError(f"--size {size}: give width and height in pixels, such as 2048x1536")
    return width, height


def _read(path: Path, size: tuple[int, int] | None) -> Calibration:
    """A camera file of any format; an error about its missing size names the options for it."""
    from .. import load
    from ..runtime.errors import CameraFileError

    try:
        return load(path, size)
    except CameraFileError as error:
        if size is None and "image_size" in str(error):
            raise CameraFileError(f"{path}: has no image size; add --size WxH or --image") from error
        raise


def _read_pair(a: Path, b: Path, size: tuple[int, int] | None) -> tuple[Calibration, Calibration]:
    """Two cameras; the size of one is taken for the other where its file does not have it."""
    from ..runtime.errors import CameraFileError

    try:
        first = _read(a, size)
    except CameraFileError:
        if size is not None:
            raise
        second = _read(b, None)
        return _read(a, second.image_size), second
    return first, _read(b, size or first.image_size)


@cloup.group(
    cls=console.CommandGroup,
    name="lfcal",
    context_settings={"help_option_names": ["-h", "--help"]},
    other_programs=dict.fromkeys(_LFRENDER_COMMANDS, "lfrender"),
    file_command="calibrate {} -o camera.json",
)
@click.version_option(package_name="lfrender", prog_name="lfcal")
def main() -> None:
    """Find the microimages of a focused plenoptic camera, and write them as a camera file."""


main.section("Calibrate a camera", calibrate, lattice)
main.section("Look at camera files", info, show, compare)
main.section("Use them elsewhere", convert, flatten)
main.section("Measure in metres", board, metric)


if __name__ == "__main__":
    main()
