"""A sequence rendered by the workers of a Dask cluster, with the same pictures as on one machine."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

from .batch import render_frames
from .job import FrameResult
from .workers import connect

__all__ = ["connect", "render_frames_on"]


def render_frames_on(client: Any, *given: Any, **options: Any) -> Generator[FrameResult, None, None]:
    """`render_frames` on a cluster with this `client` (distributed.Client); the pictures are the same bit for bit.

    Workers read image files themselves and write the pictures: inputs and `folder` must lie on storage that all of
    them see under the same path. Frames of videos are decoded here and sent. Work of a lost worker is done again.

    Examples
    --------
    >>> import lfrender
    >>> from distributed import Client  # doctest: +SKIP
    >>> client, frames = Client("tcp://host:8786"), lfrender.open_frames(["/data/frames"])  # doctest: +SKIP
    >>> [done.outcome for done in render_frames_on(client, frames, "/data/pictures")]  # doctest: +SKIP
    """
    return render_frames(*given, client=client, **options)
