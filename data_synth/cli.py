"""`lfsynth`: simulate a scene and write the flat, the white image and the truth."""

from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import click

from .camera import LATTICES, Camera
from .scenes import SCENES

__all__ = ["main"]


class _OneLine(click.Command):
    """A command whose errors are one line on stderr with exit code 2."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        try:
            return super().main(*args, **{**kwargs, "standalone_mode": False})
        except click.Abort:
            click.echo("lfsynth: interrupted", err=True)
            sys.exit(130)
        except click.ClickException as error:
            _fail(error.format_message())
        except (ValueError, OSError) as error:
            _fail(str(error))


def _fail(message: str) -> None:
    click.echo(f"lfsynth: {' '.join(message.split())}", err=True)
    sys.exit(2)


class _Pair(click.ParamType):
    """Two numbers with a separator between, such as 1100x900."""

    def __init__(self, name: str, separator: str, kind: type) -> None:
        self.name, self.separator, self.kind = name, separator, kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if isinstance(value, tuple):
            return value
        parts = value.lower().split(self.separator)
        try:
            if len(parts) == 2:
                return self.kind(parts[0]), self.kind(parts[1])
        except ValueError:
            pass
        self.fail(f"{value!r} is not {self.name}", param, ctx)


def _list_scenes(ctx: click.Context, _param: click.Parameter, wanted: bool) -> None:
    if not wanted or ctx.resilient_parsing:
        return
    for name, make in SCENES.items():
        click.echo(f"{name:10s} {(make.__doc__ or '').strip().splitlines()[0]}")
    click.echo(
        "board      A checkerboard in random poses, for metric calibration (--poses, --k1, "
        "--tilt, --range)."
    )
    ctx.exit()


_EXAMPLES = """\b
Examples:
  lfsynth house -o capture
  lfsynth clutter -o capture --size 2000x1500 --pitch 34.9 --lattice square --noise 9000,5
  lfsynth board -o shoot --pitch 28.3 --poses 12 --k1 -0.5 --tilt 0.2,0 --noise 12000,5
"""


@click.command(
    cls=_OneLine, epilog=_EXAMPLES, context_settings={"help_option_names": ["-h", "--help"]}
)
@click.argument("scene", type=click.Choice([*SCENES, "board"]))
@click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    required=True,
    help="Folder to write.",
)
@click.option(
    "--size",
    type=_Pair("WIDTHxHEIGHT", "x", int),
    default="1100x1100",
    show_default=True,
    help="Flat [px].",
)
@click.option(
    "--pitch",
    type=float,
    default=23.2,
    show_default=True,
    help="Distance D between microimages [px].",
)
@click.option("--lattice", type=click.Choice(list(LATTICES)), default="hex", show_default=True)
@click.option(
    "--rotation",
    type=float,
    default=0.0,
    show_default=True,
    help="Of the lattice, clockwise [degrees].",
)
@click.option(
    "--types",
    type=click.Choice(["1", "2", "3"]),
    default="1",
    show_default=True,
    help="Kinds of microlenses.",
)
@click.option("--square-aperture", is_flag=True, help="Square microimages.")
@click.option(
    "--microimage-fill",
    type=float,
    default=0.97,
    show_default=True,
    help="Width of microimages over D.",
)
@click.option(
    "--mosaic",
    type=click.Choice(["RGGB", "BGGR", "GRBG", "GBRG"]),
    help="Colour filters on the sensor.",
)
@click.option(
    "--noise",
    type=_Pair("FULL_WELL,READ", ",", float),
    help="Electrons, e.g. 12000,5; none if absent.",
)
@click.option(
    "--poses", type=click.IntRange(1), default=12, show_default=True, help="Of the board."
)
@click.option(
    "--range",
    "ratios",
    type=_Pair("NEAR,FAR", ",", float),
    default="-0.5,-0.18",
    help="s/D of the boards.",
)
@click.option(
    "--k1", type=float, default=0.0, help="Radial distortion of the main lens; of boards only."
)
@click.option(
    "--tilt",
    type=_Pair("X,Y", ",", float),
    default="0,0",
    help="Of the array [degrees]; of boards only.",
)
@click.option("--bits", type=click.Choice(["8", "16"]), default="8", show_default=True)
@click.option("--linear", is_flag=True, help="Store linear values instead of sRGB.")
@click.option(
    "--samples",
    type=int,
    default=48,
    show_default=True,
    help="Rays per pixel; few make noise of their own.",
)
@click.option(
    "--seed",
    type=int,
    default=0,
    show_default=True,
    help="Of the scene, the sampling and the noise.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
@click.option("--quiet", is_flag=True, help="Print nothing.")
@click.option(
    "--verbose",
    is_flag=True,
    help="Print each stage on stderr, with its seconds, as soon as it has ended.",
)
@click.version_option(package_name="lfrender", prog_name="lfsynth")
@click.option(
    "--list",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_list_scenes,
    help="List the scenes.",
)
def main(
    scene: str,
    output: Path,
    size: tuple[int, int],
    pitch: float,
    lattice: str,
    rotation: float,
    types: str,
    square_aperture: bool,
    microimage_fill: float,
    mosaic: str | None,
    noise: tuple[float, float] | None,
    poses: int,
    ratios: tuple[float, float],
    k1: float,
    tilt: tuple[float, float],
    bits: str,
    linear: bool,
    samples: int,
    seed: int,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """Simulate SCENE with a focused plenoptic camera and write flat, white image and truth to a
    folder.
    """
    from .simulator import simulate

    started = last = time.perf_counter()

    def ended(stage: str) -> None:
        nonlocal last
        last, before = time.perf_counter(), last
        if verbose:
            click.echo(f"{stage}: {last - before:.3f} s", err=True)

    focus = {"1": (0.04,), "2": (-0.45, -0.2), "3": (-0.45, -0.3, -0.2)}[types]
    camera = Camera.design(
        size, pitch, lattice, rotation, focus=focus, microimage_fill=microimage_fill
    )
    camera = camera.replace(square_aperture=square_aperture, mosaic=mosaic)
    # A simulation that cannot be written would be lost.
    places = (output, *output.absolute().parents)
    with TemporaryFile(dir=next(place for place in places if place.exists())):
        pass
    if scene == "board":
        from .boards import shoot_board

        camera = camera.replace(k1=k1, tilt=(math.radians(tilt[0]), math.radians(tilt[1])))
        shoot = shoot_board(
            camera, poses, ratios=ratios, samples=samples, seed=seed, noise=noise, gamma=not linear
        )
        ended("simulate")
        shoot.save(output)
        ended("write")
        figures = shoot.summary() | {
            "folder": str(output),
            "seconds": round(time.perf_counter() - started, 2),
        }
        if as_json:
            click.echo(json.dumps(figures))
        elif not quiet:
            click.echo(
                f"{output}: {poses} flats of a board with squares of {shoot.square} mm, "
                f"{figures['seconds']} s"
            )
        return
    capture = simulate(
        SCENES[scene](camera, seed=seed),
        camera,
        samples=samples,
        seed=seed,
        noise=noise,
        bits=int(bits),
        gamma=not linear,
    )
    ended("simulate")
    capture.save(output)
    ended("write")
    summary = capture.summary() | {
        "folder": str(output),
        "seconds": round(time.perf_counter() - started, 2),
    }
    if as_json:
        click.echo(json.dumps(summary))
    if as_json or quiet:
        return
    click.echo(
        f"{output}: {scene}, {size[0]} x {size[1]} px, {summary['lenses']} lenses "
        f"({summary['telescopic']} telescopic, {summary['binocular']} binocular, "
        f"{summary['unresolvable']} unresolvable), {summary['seconds']} s"
    )


if __name__ == "__main__":
    main()
