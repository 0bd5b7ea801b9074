"""The frames of a sequence of one camera, rendered into pictures or a film; depth is kept where
nothing moves.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from lfcal import Calibration, OutputError
from lfcal.runtime.arrays import Exposure
from lfcal.runtime.errors import check_type

from ..output.formats import check_format
from ..output.picture import default_exposure
from ..output.resume import Checkpoint, file_identity, fingerprint
from ..runtime.choices import Preset
from .film_file import film_results
from .frames import Frame, Frames, is_video
from .job import FrameResult, Job, load_camera, render_group
from .view_grid import ViewGrid
from .workers import Workers

__all__ = ["Plan", "render_film", "render_frames"]


class Plan(NamedTuple):
    """What a run will do."""

    frames: int  # in all, kept ones included; 0 if it is not known
    kept: int  # whose pictures are there already
    size: (
        tuple[int, int] | None
    )  # columns and rows of the pictures; None if no frame could be analysed
    colours: (
        tuple[float, float] | None
    )  # magnification at the blue and at the red end of depth pictures


def render_frames(
    frames: Iterable[Frame],
    folder: str | os.PathLike[str],
    calibration: Calibration | None = None,
    *,
    preset: Preset = "balanced",
    scale: float | None = None,
    suffix: str = ".tif",
    overwrite: bool = False,
    views: ViewGrid | None = None,
    eight_bits: bool = False,
    depth_maps: str | os.PathLike[str] | None = None,
    rate: float | Fraction | None = None,
    announce: Callable[[Plan], None] | None = None,
    segment: int = 30,
    group: int = 5,
    client: Any = None,
    threads: int | None = None,
    exposure: Exposure | None = None,
) -> Generator[FrameResult, None, None]:
    """Render the frames of a sequence into a folder, one picture a frame.

    The folder also gets a hidden folder with the camera, the settings, and a depth map every 5
    frames. Run again with the same settings, only missing pictures are rendered, and they are the
    same as in one run. A frame that cannot be read or analysed is reported, and the others are
    rendered. OutputError if the folder or a picture cannot be written, or if it holds pictures made
    with other settings.

    Parameters
    ----------
    frames : Frames
        From `open_frames`, or any frames.
    folder : path-like
        Made where it does not exist; its parent must exist.
    calibration : Calibration or None
        With None that of an earlier run into this folder, or else calibrated from the first frame
        that can be.
    preset : {"fast", "balanced", "accurate"}
    scale : float or None
        Output pixels per pitch; with None the full resolution of the first frame, for all frames.
    suffix : str
        Format of the pictures: `".tif"`, `".png"`, ...
    overwrite : bool
        Remove what is in the folder for these frames, and render them again.
    views : ViewGrid, optional
        Views of a grid instead of one picture: raw video of each view, `v000-1920x1080.yuv` and so
        on, if `suffix` is `".yuv"` or a pixel format such as `".yuv444p12"`, else a folder for each
        frame, `FRAME/image_001.png` and so on. Raw video appears once the last result has been
        taken; a frame that fails shows the one before it.
    eight_bits : bool
        Write pictures with 8 bits a channel, 0 to white in proportion; JPEG and WebP have no more
        anyway.
    exposure : float or "auto", optional [EV]
        As for `write_picture`; all pictures have one gain, which `"auto"` takes of the first frame.
    depth_maps : path-like, optional
        Folder for the depth map of each frame, `FRAME.npz`, or a film of depth pictures:
        magnification in the colours of `lfrender analyze --picture`, blue and red at the ends of
        the first frame for all.
    rate : float, optional
        Pictures a second of that film; with None those of the first video, else 25.
    announce : callable, optional
        Called once with a `Plan`, before the first picture is written.
    segment, group : int
        Frames from one key frame to the next, and frames that are compared with the same one, the
        first of them.
    client, threads
        As in `analyze_large`.

    Yields
    ------
    FrameResult
        In the order of the frames, some at a time.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/0.png", flat)
    ...     frames = lfrender.open_frames([folder])
    ...     [done.outcome for done in lfrender.render_frames(frames, f"{folder}/out", camera, preset="fast")]
    ['rendered']
    """
    check_type(frames, Iterable, "frames", "lfrender.open_frames finds them")
    known = frames if isinstance(frames, Frames) else Frames(())
    # Workers may have another working directory.
    place = Path(folder) if client is None else Path(folder).absolute()
    maps = None if depth_maps is None else Path(depth_maps).absolute()
    film = maps if maps is not None and is_video(maps) else None
    if film is not None:
        check_format(film, "film", inputs=known.files)
        if film.exists() and not overwrite:
            raise OutputError(
                f"{film}: is there already; give another output, or render it again (--overwrite)"
            )
    dark = None if known.dark is None else str(known.dark)
    exposure = default_exposure(f"picture{suffix}") if exposure is None else exposure
    job = Job(
        place,
        calibration,
        preset,
        scale,
        suffix,
        views,
        eight_bits,
        dark,
        known.encoded,
        maps,
        exposure=exposure,
    )
    job.start(overwrite, known.names)
    results = _render(
        job, frames, known.names, overwrite, segment, group, announce, Workers(client, threads, 2)
    )
    if film is None:
        yield from results
        return
    speed = Fraction(rate or known.rate or 25)
    depth_of = job.depth_path_of
    yield from film_results(
        results, film, job.hidden, speed, lambda result: depth_of(result.name), rendering="depth"
    )
    shutil.rmtree(depth_of("").parent)


def _render(
    job: Job,
    frames: Iterable[Frame],
    names: list[str],
    overwrite: bool,
    segment: int,
    group: int,
    announce: Callable[[Plan], None] | None,
    workers: Workers,
) -> Generator[FrameResult, None, None]:
    kept = 0 if overwrite else sum(not job.is_missing(name) for name in names)
    groups = job.groups(frames, overwrite, segment, group)
    first = next(groups)
    if overwrite:
        job.remove(names)
    if announce is not None:
        announce(Plan(len(names), kept, job.size, job.colours))
    done: list[str] = []
    # Two groups at once keep all cores busy in steps of one thread.
    for results in workers.map(render_group, job, chain([first], groups)):
        for result in results:
            done.append(result.name)
            yield result
    if job.output is not None:
        job.output.finish(done)


def render_film(
    frames: Frames,
    path: str | os.PathLike[str],
    calibration: Calibration | None = None,
    *,
    preset: Preset = "balanced",
    scale: float | None = None,
    rate: float | Fraction | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Iterator[FrameResult]:
    """Render the frames of a sequence into a film, which is complete once the last result has been
    taken.

    Pictures are those of `render_frames`. Until the film is complete they are kept in a hidden
    folder beside it, from which a run that was killed is continued. In place of a frame that fails
    the picture before it is repeated. Errors say that the film cannot be written (OutputError,
    PictureError), is there already, or has no picture (FlatError).

    The suffix of `path` chooses the film: `.mp4` is H.264 with 8 bits up to the white of the
    camera, nearly lossless, `.mov` ProRes 422 HQ with 10 bits, `.mkv` FFV1, lossless, also with 16
    bits, `.yuv` raw planes, 4:2:0 of 10 bits; all need the package `av`. It has `rate` pictures a
    second, with None those of the first video, else 25. `overwrite` replaces an existing film, and
    renders all pictures again; the rest is as for `render_frames`.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/0.png", flat)
    ...     done = list(render_film(lfrender.open_frames([folder]), f"{folder}/film.mp4", camera, preset="fast"))
    >>> [frame.outcome for frame in done]
    ['rendered']
    """
    check_type(frames, Frames, "frames", "lfrender.open_frames finds them")
    output = Path(path).absolute()
    check_format(output, "film", inputs=frames.files)
    checkpoint = Checkpoint(output)
    if options.get("exposure") is None:
        options["exposure"] = default_exposure(output)
    camera = None if calibration is None else calibration.to_dict()
    files = [file_identity(file) for file in (*frames.files, frames.dark)]
    key = fingerprint(files, str(frames.chosen), camera, preset, scale, options["exposure"])
    # One that was begun with `overwrite` may be finished without.
    if overwrite or checkpoint.find("film", key) is None:
        if output.exists() and not overwrite:
            raise OutputError(
                f"{path}: is there already; give another output, or render it again (--overwrite)"
            )
        checkpoint.remove()
        checkpoint.keep("film", key)
    results = film_results(
        render_frames(
            frames,
            checkpoint.folder,
            calibration,
            preset=preset,
            scale=scale,
            rate=rate,
            **options,
        ),
        output,
        checkpoint.folder,
        Fraction(rate or frames.rate or 25),
        lambda result: result.path,
        cache(lambda: load_camera(checkpoint.folder).white_level),
        rendering="all in focus",
        preset=preset,
    )
    for result in results:
        yield replace(result, path=output)
    checkpoint.remove()
