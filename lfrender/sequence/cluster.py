"""A sequence rendered by the workers of a Dask cluster, with the same pictures as on one machine."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable
from typing import Any

from .batch import render_frames
from .frames import Frame
from .job import FrameResult
from .workers import connect

__all__ = ["connect", "render_frames_on"]


def render_frames_on(
    client: Any, frames: Iterable[Frame], folder: str | os.PathLike[str], *more: Any, **options: Any
) -> Generator[FrameResult, None, None]:
    """`render_frames` on a cluster with this `client` (distributed.Client); the pictures are the same bit for bit.

    Workers read image files themselves and write the pictures: inputs and `folder` must lie on storage that all of
    them see under the same path. Frames of videos are decoded here and sent. Work of a lost worker is done again.

    Examples
    --------
    >>> import lfrender
    >>> from distributed import Client  # doctest: +SKIP
    >>> client = Client("tcp://host:8786")  # doctest: +SKIP
    >>> frames = lfrender.open_frames(["/data/frames"])  # doctest: +SKIP
    >>> for done in render_frames_on(client, frames, "/data/pictures"):  # doctest: +SKIP
    ...     print(done.name, done.outcome)
    """
    return render_frames(frames, folder, *more, client=client, **options)
