"""A sequence rendered into a film; its finished pictures are kept until the film is whole."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal import Calibration, FlatError, OutputError, read_flat

from ..output.resume import Checkpoint, file_identity, fingerprint
from ..output.tiled_picture import move_into_place
from .film_file import FilmFile, check_film, film_pixels
from .frames import Frames
from .job import FrameResult, load_camera

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["render_film"]

# Pictures a second where neither the user nor a video says.
_RATE = Fraction(25)
# Rates of television have such denominators; other digits of a decimal number are rounding.
_FINEST = 1001


def render_film(
    frames: Frames,
    path: str | os.PathLike[str],
    calibration: Calibration | None = None,
    *,
    preset: str = "balanced",
    scale: float | None = None,
    rate: float | Fraction | None = None,
    overwrite: bool = False,
    client: Client | None = None,
    threads: int | None = None,
) -> Iterator[FrameResult]:
    """Render the frames of a sequence into a film, which is there once the last result has been taken.

    Pictures are those of `render_frames`. Until the film is whole they lie in a hidden folder beside it; a run that
    was killed goes on with them. In place of a frame that fails the one before is shown again, so that time goes on.

    Parameters
    ----------
    frames : Frames
        From `open_frames`.
    path : path-like
        `.mp4`: H.264 with 8 bits up to the white of the camera, nearly lossless; `.mkv`: FFV1, lossless, also with 16
        bits. Needs the package `av`.
    calibration, preset, scale
        As in `render_frames`.
    rate : float, Fraction or None
        Pictures a second; with None that of the first video, else 25.
    overwrite : bool
        Replace a film that is there, and render all pictures anew.
    client : distributed.Client or None
        Render on this cluster, as `render_frames_on`.
    threads : int or None
        As in `render_frames_on`.

    Yields
    ------
    FrameResult
        In the order of the frames.

    Raises
    ------
    OutputError, PictureError
        If the film cannot be written, or is there already.
    FlatError
        If none of the frames can be rendered.
    """
    output = Path(path).absolute()
    check_film(output, frames.files)
    if output.exists() and not overwrite:
        raise OutputError(f"{path}: is there already; give another output, or render it anew (--overwrite)")
    unfinished = Checkpoint(output)
    camera = None if calibration is None else calibration.to_dict()
    key = fingerprint([file_identity(file) for file in frames.files], camera, preset, scale)
    if overwrite or unfinished.find("film", key) is None:
        unfinished.remove()
        unfinished.keep("film", key)
    speed = Fraction(rate or frames.rate or _RATE).limit_denominator(_FINEST)
    pictures = _pictures(frames, unfinished.folder, calibration, preset, scale, client, threads)
    comment = json.dumps({"software": "lfrender", "rendering": "all in focus", "preset": preset})
    half = unfinished.folder / f"film{output.suffix.lower()}"
    with FilmFile(half, speed, comment) as film, ThreadPoolExecutor(1) as encoder:
        waiting: Future[None] | None = None
        shown: Path | None = None
        white: float | None = None
        times = 0
        for result in pictures:
            shown = shown if result.outcome == "failed" else result.path
            times += 1
            if shown is not None:
                if waiting is not None:
                    waiting.result()
                if waiting is None:
                    white = load_camera(unfinished.folder).white_level
                waiting = encoder.submit(_add, film, shown, times, white)
                times = 0
            yield replace(result, path=output)
        if waiting is None:
            raise FlatError(f"{path}: is not written, because none of the frames could be rendered")
        waiting.result()
    move_into_place(half, output)
    unfinished.remove()


def _pictures(
    frames: Frames,
    folder: Path,
    calibration: Calibration | None,
    preset: str,
    scale: float | None,
    client: Client | None,
    threads: int | None,
) -> Iterator[FrameResult]:
    if client is None:
        from .batch import render_frames

        return render_frames(frames, folder, calibration, preset=preset, scale=scale)
    from .cluster import render_frames_on

    return render_frames_on(client, frames, folder, calibration, preset=preset, scale=scale, threads=threads)


def _add(film: FilmFile, picture: Path, times: int, white: float | None) -> None:
    pixels = film_pixels(read_flat(picture), film.eight_bits, white)
    for _ in range(times):
        film.add(pixels)
