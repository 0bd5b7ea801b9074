"""A sequence rendered by the workers of a Dask cluster, with the same pictures as on one machine."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

from .film import render_frames
from .job import FrameResult
from .workers import connect

__all__ = ["connect", "render_frames_on"]


def render_frames_on(
    client: Any, *given: Any, **options: Any
) -> Generator[FrameResult, None, None]:
    """`render_frames(..., client=client)`: on a cluster, with the same pictures bit for bit.

    Workers read image files and write pictures: inputs and `folder` must have the same path for all
    of them.

    Examples
    --------
    >>> import lfrender
    >>> from distributed import Client  # doctest: +SKIP
    >>> client, frames = Client("tcp://host:8786"), lfrender.open_frames(["/data/frames"])  # doctest: +SKIP
    >>> [done.outcome for done in render_frames_on(client, frames, "/data/pictures")]  # doctest: +SKIP
    """
    return render_frames(*given, client=client, **options)
