"""The table of all options of the commands: names, type, help, and how the value is shown."""

from __future__ import annotations

from typing import Any, get_args

import click

from lfcal.runtime import command_line as cl
from lfcal.runtime.image_formats import MOSAICS

from ..runtime.choices import Detail, PoseFormat, Preset, Tone
from ..runtime.types import Entries

__all__ = ["DEPTH_FORMS", "TABLE"]

#: Suffixes of the forms of depth beside .npz, by the option for each; an output with that of
#: several is the first one.
DEPTH_FORMS = {
    "dense": (".tif", ".tiff", ".pfm", ".exr"),
    "picture": (".png",),
    "uncertainty": (".png",),
    "ply": (".ply", ".pcd"),
    "mesh": (".glb", ".ply"),
}

_OUTPUT = cl.OutputPath()
_GRID = cl.Pair("ROWSxCOLUMNS", "5x5")
_PRESET = click.Choice(get_args(Preset))
_POSES = click.Choice(get_args(PoseFormat))
_POSITIVE = click.FloatRange(0, min_open=True)
_SHARE = click.FloatRange(0, 1, min_open=True)


def _row(*names_kind_help: Any, **more: Any) -> tuple[tuple[Any, ...], Entries]:
    return names_kind_help, more


#: Names, type, help and further arguments of `command_line.option`, by the name of the value.
TABLE = {
    # Of the capture.
    "camera": _row(
        "-c --camera",
        cl.INPUT,
        "Camera file of lfcal, or a published calibration (.xml, .cfg). Without it, FLAT itself "
        "is calibrated.",
    ),
    "white": _row("--white", cl.INPUT, "Calibrate from this white image of the same camera."),
    "no_check": _row(
        "--no-check",
        bool,
        "Use the camera whatever the flat shows; else another camera is an error (exit code 2), "
        "and a shifted one is moved onto the microimages.",
    ),
    "depth_file": _row("--depth depth_file", cl.INPUT, "Depth map made by 'lfrender analyze'."),
    "dark": (cl.DARK, {}),
    "preset": _row(
        "--preset", _PRESET, "How much time the depth analysis may take. [default: balanced]"
    ),
    "roi": _row(
        "--roi",
        float,
        "Only the part between two opposite corners [px of the flat].",
        "X0 Y0 X1 Y1",
        nargs=4,
    ),
    "mosaic": _row(
        "--mosaic",
        click.Choice(MOSAICS, case_sensitive=False),
        "Colour filters of the top left 2 x 2 pixels of a raw mosaic, if the camera file does "
        "not have them.",
    ),
    **{name: (row, {}) for name, row in cl.READING.items()},
    # What to draw.
    "patch_size": _row(
        "--patch-size",
        float,
        "One signed patch size [px] for all lenses: > 0 telescopic, < 0 binocular.",
    ),
    "blend": _row(
        "--blend", bool, "With --patch-size: the mean over lenses instead of the nearest one."
    ),
    "traditional": _row(
        "--traditional", bool, "One pixel per microlens, the mean of its microimage."
    ),
    "scale": _row("--scale", _POSITIVE, "Output pixels per microlens pitch."),
    "edges": _row(
        "--edges/--no-edges",
        None,
        "Place depth edges on the pixels of the microimages: cleaner outlines, in up to twice the "
        "time. The preset 'balanced' does so.",
        default=None,
    ),
    "detail": _row(
        "--detail",
        click.Choice(get_args(Detail)),
        "Undo the blur of the microlenses, place by place, as noise allows. [default: natural, "
        "for depth maps]",
    ),
    "at": _row("--at", float, "Focus on this place [px of the flat].", "X Y", nargs=2),
    "patch_sizes": _row(
        "--patch-size patch_sizes",
        float,
        "Signed patch size [px] in focus: > 0 telescopic, < 0 binocular. Several: a focal stack.",
        multiple=True,
    ),
    "stack": _row(
        "--stack",
        click.IntRange(1),
        "N pictures from the farthest depth to the nearest.",
        "N",
    ),
    "focus_aperture": _row(
        "--aperture aperture",
        float,
        "Part of the aperture used, 0.05 to 1.",
        default=1.0,
        show_default=True,
    ),
    "exhaustive": _row("--exhaustive", bool, "Take no shortcuts: match every lens at every shift."),
    # Views.
    "grid": _row(
        "--grid", _GRID, "Pictures on a grid of viewpoints, row1_column1 ... [default: 5x5]"
    ),
    "stereo": _row(
        "--stereo", bool, "The view of the left eye, and beside it that of the right one."
    ),
    "animation": _row(
        "--animation",
        click.IntRange(2),
        "N views around a circle; 24 where the output is .gif, .webp, .mp4, .mov or .mkv.",
        "N",
    ),
    "quilt": _row(
        "--quilt",
        cl.Pair("COLUMNSxROWS", "8x6"),
        "Views from left to right in one picture, for holographic displays: 8x6.",
    ),
    "poses": _row(
        "--poses",
        _POSES,
        "The grid with cameras, depth and masks for this program; metric with known optics.",
    ),
    "view_aperture": _row(
        "--aperture aperture",
        _SHARE,
        "How far from the middle, as a part of the radius of the microimages: more parallax, "
        "less light.",
        default=0.7,
        show_default=True,
    ),
    "resize": _row(
        "--resize", cl.SIZE, "Width and height of the pictures [px], in place of --scale."
    ),
    "grid_format": _row(
        "--format suffix",
        str,
        "Of the grid's pictures: tif, png, yuv, ...",
        default="tif",
        show_default=True,
    ),
    "frame_views": _row(
        "--views",
        _GRID,
        "Views of a grid: with --format yuv a file for each, v000-WxH.yuv ..., else "
        "FRAME/image_001 ...",
    ),
    "frame_aperture": _row(
        "--aperture aperture", _SHARE, "Of --views, as in 'lfrender views'. [default: 0.7]"
    ),
    # How to write it.
    "eight_bits": _row(
        "--8bit eight_bits",
        bool,
        "Write 8 bits a channel. JPEG and WebP do so by themselves.",
    ),
    "exposure": _row(
        "--exposure",
        cl.ExposureValue(),
        "Brighten by so many EV of light, or dim pictures by their content. [default: auto for "
        "JPEG, WebP, GIF and films of linear flats]",
    ),
    "tone": _row(
        "--tone",
        click.Choice(get_args(Tone)),
        "Write values in proportion to light, or by the curve of sRGB. [default: auto: linear "
        "flats by that of sRGB as JPEG, WebP, GIF, film and with 8 bits; all others as they are]",
        default="auto",
    ),
    "white_balance": _row(
        "--white-balance",
        cl.BalanceValue(),
        "Gains of red, green and blue. [default: auto: of flats behind colour filters by the white "
        "image, or else by grey world]",
        default="auto",
    ),
    "quality": _row(
        "--quality",
        click.IntRange(1, 100),
        "Of JPEG and WebP: more has less error and larger files. [default: 95]",
        "1..100",
    ),
    "alpha": _row("--alpha", bool, "Make pixels that no lens has seen transparent (not in JPEG)."),
    "compress": _row("--compress", bool, "Write a TIFF in deflated tiles: smaller and slower."),
    "tile": _row(
        "--tile",
        click.IntRange(16),
        "Draw in tiles of this side, with little memory; an interrupted run is continued. "
        "[default: large flats]",
        "PIXELS",
    ),
    "frame_format": _row(
        "--format suffix",
        str,
        "Format of the pictures: tif, jpg, ...; of views also yuv. [default: tif]",
    ),
    "frames": _row(
        "--frames",
        str,
        "Only these of all frames, counted from 0, as Python slices do: 10:60:2, 10:, ::2, or 7.",
        "START:STOP:STEP",
    ),
    "start": _row(
        "--start",
        click.FloatRange(0),
        "Only frames from this time of a video on.",
        "SECONDS",
    ),
    "end": _row(
        "--end",
        click.FloatRange(0, min_open=True),
        "Only frames before this time of a video.",
        "SECONDS",
    ),
    "depth_maps": _row(
        "--depth-maps",
        cl.OutputPath(),
        "Also the depth of every frame: FRAME.npz in a folder, or a film of depth in colours.",
        "FOLDER|FILM",
    ),
    "fps": _row(
        "--fps",
        click.FloatRange(0, 1000, min_open=True),
        "Pictures a second of a film. [default: those taken of the input, or 25]",
    ),
    "overwrite": _row(
        "--overwrite", bool, "Render all frames again; else pictures already there are kept."
    ),
    "dense": _row(
        "--dense",
        cl.OutputPath(suffixes=DEPTH_FORMS["dense"]),
        "Patch size [px] of every pixel of the picture, its validity and standard error (pages, "
        "or channels).",
        "DEPTH.tif|.pfm|.exr",
    ),
    "unfilled": _row(
        "--unfilled",
        bool,
        "Write NaN to --dense where no lens has a depth, not that of places around.",
    ),
    "picture": _row(
        "--picture",
        cl.OutputPath(suffixes=DEPTH_FORMS["picture"]),
        "Depth in colours: far is dark, near is light.",
        "DEPTH.png",
    ),
    "uncertainty": _row(
        "--uncertainty",
        cl.OutputPath(suffixes=DEPTH_FORMS["uncertainty"]),
        "Standard error of the patch size in colours: sure is dark, unsure is light.",
        "ERROR.png",
    ),
    "ply": _row(
        "--ply",
        cl.OutputPath(suffixes=DEPTH_FORMS["ply"]),
        "Point cloud: X/D, Y/D, virtual depth D/s, colour.",
        "CLOUD.ply|.pcd",
    ),
    "mesh": _row(
        "--mesh",
        cl.OutputPath(suffixes=DEPTH_FORMS["mesh"]),
        "The scene as textured triangles (needs trimesh).",
        "MESH.glb|.ply",
    ),
    "optics": _row(
        "--optics",
        cl.INPUT,
        "Focal length and distances [mm] of the camera: distances in metres, the point cloud and "
        "--poses too. By default those of the camera file, if 'lfcal metric' has measured them.",
        "OPTICS.json",
    ),
    "metres": _row("--metres", bool, "Write --dense as distances in front of the main lens [m]."),
    # Of volumes.
    "na": _row("--na", _POSITIVE, "Numerical aperture of the objective."),
    "magnification": _row("--magnification", _POSITIVE, "From the specimen to the microlenses."),
    "medium_index": _row(
        "--medium-index",
        _POSITIVE,
        "Refractive index about the specimen.",
        default=1.33,
        show_default=True,
    ),
    "microlens_focal_length": _row(
        "--microlens-focal-length", _POSITIVE, "Of the microlenses.", "UM"
    ),
    "pixel_size": _row(
        "--pixel-size",
        _POSITIVE,
        "Side of a pixel, as the microlenses see it through relay lenses.",
        "UM",
    ),
    "wavelength": _row("--wavelength", _POSITIVE, "For the blur of diffraction.", "NM"),
    "depth_range": _row(
        "--depth-range",
        float,
        "First and last plane, from the native plane towards the objective [um], or without optics "
        "as slopes k = -D / s. [default: as far as a pixel averages over a pitch]",
        "FIRST LAST",
        nargs=2,
    ),
    "planes": _row(
        "--planes", click.IntRange(2), "Number of planes.", default=41, show_default=True
    ),
    "steps": _row(
        "--steps",
        click.IntRange(1),
        "Of the deconvolution, at most.",
        default=40,
        show_default=True,
    ),
    "voxels": _row(
        "--voxels",
        click.IntRange(2),
        "Along each side of a microlens.",
        default=8,
        show_default=True,
    ),
    "interval": _row(
        "--interval",
        _POSITIVE,
        "From one flat to the next. [default: of a video, its own; else not stated]",
        "SECONDS",
    ),
    # Where to show it.
    "export": _row(
        "--export",
        _OUTPUT,
        "Write the page instead: as one file that holds everything, or as a folder of static files "
        "for web pages.",
        "FOLDER|PAGE.html",
    ),
    "port": _row(
        "--port",
        click.IntRange(0, 65535),
        "Port on this machine; by default a free one.",
        default=0,
    ),
    "no_browser": _row(
        "--no-browser", bool, "Only print the address of the page, do not open a browser."
    ),
    "host": _row(
        "--host",
        str,
        "Serve the page on this address, for other machines too; the page then needs a token.",
        "ADDRESS",
        default="127.0.0.1",
        show_default=True,
    ),
    # Of live frames.
    "live_folder": _row(
        "-o --output",
        _OUTPUT,
        "Folder for recordings and snapshots.",
        "FOLDER",
        default=".",
        show_default=True,
    ),
    "live_format": _row(
        "--pixel-format",
        str,
        "What a GenICam camera is set to: Mono8, Mono12, BayerRG8, ... [default: as it is]",
        "FORMAT",
    ),
    "live_rate": _row(
        "--fps",
        click.FloatRange(0, 1000, min_open=True),
        "Frames a second of files. [default: of the video, or 10]",
    ),
    "live_exposure": _row(
        "--exposure",
        cl.ExposureValue(),
        "Show frames brighter by so many EV. [default: auto: dim ones by their content, until "
        "the next calibration]",
    ),
    "live_preset": _row(
        "--preset", _PRESET, "How much time the depth analysis may take. [default: fast]"
    ),
    # Several processes.
    "workers": _row(
        "--workers", click.IntRange(1), "Work in so many processes of this machine (needs Dask)."
    ),
    "scheduler": _row("--scheduler", str, "Work on this Dask scheduler.", "tcp://HOST:PORT"),
    "processes": _row(
        "--processes",
        click.IntRange(1),
        "Processes that compile. [default: all cores]",
        "N",
    ),
}
