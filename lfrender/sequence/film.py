"""The frames of a sequence, rendered into pictures or a film; depth is kept where nothing moves."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from lfcal import Calibration, OutputError
from lfcal.runtime.errors import check_type
from lfcal.runtime.output_file import claim
from lfcal.runtime.progress import Progress, show_progress

from ..output.formats import check_format
from ..output.resume import Checkpoint
from ..runtime.types import AnyPath, Size
from .film_file import Results, film_results
from .frames import Frame, Frames, is_video
from .options import FrameOptions
from .run import FrameResult, Run, render_group
from .run_folder import RunFolder
from .workers import Workers

__all__ = ["DEFAULT_RATE", "Plan", "render_film", "render_frames"]

#: Frames per second of films whose frames have no rate.
DEFAULT_RATE = 25
# Groups that this process renders at once: one computes in steps of one thread while the other
# uses all cores.
_GROUPS_AT_ONCE = 2


class Plan(NamedTuple):
    """What a run will do."""

    frames: int  # in all, kept ones included; 0 if it is not known
    kept: int  # whose pictures are there already
    size: Size | None  # columns and rows of the pictures; None if no frame was analysed
    colours: tuple[float, float] | None  # far and near end of depth pictures
    changes: tuple[str, ...]  # sentences about brightness and white balance, if they are changed


def render_frames(
    frames: Iterable[Frame],
    folder: AnyPath,
    calibration: Calibration | None = None,
    options: FrameOptions | None = None,
    *,
    overwrite: bool = False,
    announce: Callable[[Plan], None] | None = None,
    progress: Progress = None,
    client: Any = None,
    threads: int | None = None,
    **given: Any,
) -> Results:
    """Render the frames of a sequence into a folder, one picture per frame.

    A hidden folder inside stores the camera, the settings, and a depth map every 5 frames. The same
    call again renders only the missing pictures, with the same bits as one uninterrupted run. A
    frame that cannot be read or analysed is reported, and the others are rendered. OutputError if
    the folder or a picture cannot be written, or if it holds pictures made with other settings.

    Parameters
    ----------
    frames : Frames
        From `open_frames`, or any frames.
    folder : path-like
        Is made if it does not exist; its parent must exist.
    calibration : Calibration or None
        With None, the camera of an earlier run into this folder, or else calibrated from the first
        frame for which that succeeds.
    options : FrameOptions, optional
        Preset, scale, format, views, depth maps, ...; the defaults suit most sequences.
    overwrite : bool
        Remove what is in the folder for these frames, and render them again.
    announce : callable, optional
        Called once with a `Plan`, before the first picture is written.
    progress : bool or callable, optional
        True shows a bar; a function is called with the numbers of finished and of all frames, None
        where that is not known.
    client, threads
        As in `analyze_large`. Workers of a cluster read image files and write pictures: inputs and
        `folder` must have the same path for all of them.
    **given
        Single fields of `FrameOptions`, such as `preset="fast"`.

    Yields
    ------
    FrameResult
        In the order of the frames, in batches.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/0.png", flat)
    ...     frames = lfrender.open_frames([folder])
    ...     done = list(lfrender.render_frames(frames, f"{folder}/out", camera, preset="fast"))
    >>> [frame.outcome for frame in done]
    ['rendered']
    """
    check_type(frames, Iterable, "frames", "lfrender.open_frames finds them")
    options = replace(options or FrameOptions(), **given)
    known = frames if isinstance(frames, Frames) else Frames(())
    if options.depth_maps is not None:
        maps = Path(options.depth_maps).absolute()
        options = replace(options, depth_maps=maps)
        if is_video(maps):
            check_format(maps, "film", inputs=known.files)
            _refuse_existing(maps, overwrite)
    # Workers may have another working directory.
    place = Path(folder) if client is None else Path(folder).absolute()
    target = RunFolder(place, options, known.names, overwrite)
    run = Run(target, options, calibration, known)
    workers = Workers(client, threads, _GROUPS_AT_ONCE)
    results = _render(run, frames, known.names, overwrite, announce, workers, progress)
    if not target.makes_depth_film:
        yield from results
        return
    depth_of = target.depth_path_of
    rate = Fraction(options.rate or known.rate or DEFAULT_RATE)
    yield from film_results(
        results, maps, target.hidden, rate, lambda result: depth_of(result.name), rendering="depth"
    )
    shutil.rmtree(depth_of("").parent)


def _refuse_existing(path: Path, overwrite: bool) -> None:
    if path.exists() and not overwrite:
        problem = "is there already; give another output, or render it again (--overwrite)"
        raise OutputError(f"{path}: {problem}")


def _render(
    run: Run,
    frames: Iterable[Frame],
    names: list[str],
    overwrite: bool,
    announce: Callable[[Plan], None] | None,
    workers: Workers,
    progress: Progress,
) -> Results:
    groups = run.groups(frames, overwrite)
    first = next(groups)
    if overwrite:
        run.folder.remove(names)
    if announce is not None:
        kept = sum(not run.folder.is_missing(name) for name in names)
        colours = None if run.state is None else run.state.colours
        announce(Plan(len(names), kept, run.size, colours, tuple(run.sentences)))
    done: list[str] = []
    groups_done = workers.map(render_group, run, chain([first], groups))
    with show_progress(progress, "frames") as step:
        for result in chain.from_iterable(groups_done):
            done.append(result.name)
            step(len(done), len(names) or None)
            yield result
    if run.folder.views is not None:
        run.folder.views.finish(done)


def render_film(
    frames: Frames,
    path: AnyPath,
    calibration: Calibration | None = None,
    options: FrameOptions | None = None,
    *,
    overwrite: bool = False,
    announce: Callable[[Plan], None] | None = None,
    progress: Progress = None,
    client: Any = None,
    threads: int | None = None,
    **given: Any,
) -> Iterator[FrameResult]:
    """Render the frames of a sequence into a film, complete after the last result has been taken.

    Pictures are those of `render_frames`. Until the film is complete they are kept in a hidden
    folder beside it, from which a killed run is continued. A frame that fails repeats the picture
    before it. OutputError or PictureError if the film cannot be written or exists already,
    FlatError if it has no picture.

    The suffix of `path` chooses the film: `.mp4` is H.264 with 8 bits, nearly lossless; `.mov` is
    ProRes 422 HQ with 10 bits; `.mkv` is FFV1, lossless, also with 16 bits; `.yuv` are raw planes,
    4:2:0 with 10 bits. All need the package `av`. `overwrite` replaces an existing film, and
    renders all pictures again; everything else is as for `render_frames`.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/0.png", flat)
    ...     frames = lfrender.open_frames([folder])
    ...     done = list(render_film(frames, f"{folder}/film.mp4", camera, preset="fast"))
    >>> [frame.outcome for frame in done]
    ['rendered']
    """
    check_type(frames, Frames, "frames", "lfrender.open_frames finds them")
    output = Path(path).absolute()
    check_format(output, "film", inputs=frames.files)
    options = replace(options or FrameOptions(), **given)
    options = replace(options, shown_as=output.suffix.lower())
    camera = calibration and calibration.to_dict()
    colours = (options.exposure, options.tone, options.white_balance)
    drawn = (options.preset, options.scale, options.size, *colours)
    inputs = (*frames.files, frames.dark, str(frames.chosen), camera, drawn)
    checkpoint = Checkpoint(output, "film", *inputs)
    with claim(output):
        # A film that was begun with `overwrite` may be finished without it.
        if overwrite or checkpoint.found is None:
            _refuse_existing(output, overwrite)
            checkpoint.remove()
            checkpoint.keep()
        folder = checkpoint.folder
        run: dict[str, Any] = {"announce": announce, "client": client, "threads": threads}
        results = film_results(
            render_frames(frames, folder, calibration, options, progress=progress, **run),
            output,
            folder,
            Fraction(options.rate or frames.rate or DEFAULT_RATE),
            lambda result: result.path,
            rendering="all in focus",
            preset=options.preset,
        )
        for result in results:
            yield replace(result, path=output)
        checkpoint.remove()
