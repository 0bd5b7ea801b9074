"""The frames of a sequence rendered into a film."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

from lfcal import Calibration, OutputError
from lfcal.runtime.errors import check_type

from ..output.formats import check_format
from ..output.resume import Checkpoint, file_identity, fingerprint
from ..runtime.choices import Preset
from .batch import render_frames
from .film_file import film_results
from .frames import Frames
from .job import FrameResult, load_camera

__all__ = ["render_film"]


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
    """Render the frames of a sequence into a film, which is complete once the last result has been taken.

    Pictures are those of `render_frames`. Until the film is complete they are kept in a hidden folder beside it, from
    which a run that was killed is continued. In place of a frame that fails the picture before it is repeated. Errors
    say that the film cannot be written (OutputError, PictureError), is there already, or has no picture (FlatError).

    The suffix of `path` chooses the film: `.mp4` is H.264 with 8 bits up to the white of the camera, nearly lossless,
    `.mov` ProRes 422 HQ with 10 bits, `.mkv` FFV1, lossless, also with 16 bits, `.yuv` raw planes, 4:2:0 of 10 bits;
    all need the package `av`. It has `rate` pictures a second, with None those of the first video, else 25. `overwrite`
    replaces an existing film, and renders all pictures again; the rest is as for `render_frames`.

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
    camera = None if calibration is None else calibration.to_dict()
    files = [file_identity(file) for file in (*frames.files, frames.dark)]
    key = fingerprint(files, str(frames.chosen), camera, preset, scale)
    # One that was begun with `overwrite` may be finished without.
    if overwrite or checkpoint.find("film", key) is None:
        if output.exists() and not overwrite:
            raise OutputError(f"{path}: is there already; give another output, or render it again (--overwrite)")
        checkpoint.remove()
        checkpoint.keep("film", key)
    results = film_results(
        render_frames(
            frames, checkpoint.folder, calibration, preset=preset, scale=scale, rate=rate, **options,
        ),
        output, checkpoint.folder, Fraction(rate or frames.rate or 25), lambda result: result.path,
        cache(lambda: load_camera(checkpoint.folder).white_level), rendering="all in focus", preset=preset,
    )  # fmt: skip
    for result in results:
        yield replace(result, path=output)
    checkpoint.remove()
