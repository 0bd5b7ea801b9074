"""Pictures of flats as they come, one after another: the next is analysed while the last is drawn."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numba
from numpy.typing import NDArray

from lfcal import Calibration

from .analysis import analyze
from .depthmap import DepthMap
from .drawing import default_scale, render
from .rendering import Rendering
from .shared_cores import can_share

__all__ = ["render_stream"]

# Flats that are taken before a picture is waited for: one is drawn, one is analysed.
_AHEAD = 2


def render_stream(
    flats: Iterable[NDArray[Any]],
    calibration: Calibration | None = None,
    *,
    preset: str = "fast",
    scale: float | None = None,
) -> Iterator[tuple[DepthMap, Rendering]]:
    """Depth and all-in-focus picture of flats that come one after another, as from a camera.

    Each is analysed and drawn with the one before as `previous`: the answers are those of `analyze` and `render` called
    by turns, bit for bit. But a flat is analysed while the one before is drawn, so that no core waits for what only one
    can do. The picture of a flat comes when the next two are there, or when there are no more.

    Parameters
    ----------
    flats : iterable of (H, W) or (H, W, C) array, uint8, uint16 or float
        Of one camera, size and type. Nobody may write into them before the pictures of the next two are there.
    calibration : Calibration, optional
        By default calibrated from the first flat.
    preset : {"fast", "balanced", "accurate"}
    scale : float, optional
        Output pixels per pitch; by default the full resolution of the first flat, for all.

    Yields
    ------
    (DepthMap, Rendering)
        In the order of the flats.

    Raises
    ------
    FlatError, CalibrationError
        As `analyze`, once the pictures before that flat are out.
    """
    coming = iter(flats)
    first = next(coming, None)
    if first is None:
        return
    camera = _calibrated(first) if calibration is None else calibration
    depth = analyze(first, camera, preset)
    picture = render(first, camera, depth, scale=default_scale(depth) if scale is None else scale)
    yield depth, picture
    if not can_share(first.nbytes):
        yield from _by_turns(coming, camera, preset, first, depth, picture)
        return
    share = (max(1, numba.get_num_threads() // 2),)
    with (
        ThreadPoolExecutor(1, initializer=numba.set_num_threads, initargs=share) as analyst,
        ThreadPoolExecutor(1, initializer=numba.set_num_threads, initargs=share) as artist,
    ):
        before = _Frame(first, _known(depth), _known(picture))
        waiting: deque[_Frame] = deque()
        for flat in coming:
            analysis = analyst.submit(_analysed, flat, camera, preset, before)
            before = _Frame(flat, analysis, artist.submit(_drawn, flat, camera, analysis, before))
            waiting.append(before)
            if len(waiting) > _AHEAD:
                yield waiting.popleft().answer()
        while waiting:
            yield waiting.popleft().answer()


@dataclass(frozen=True)
class _Frame:
    """A flat with its depth and picture, once they are there."""

    flat: NDArray[Any]
    depth: Future[DepthMap]
    picture: Future[Rendering]

    def answer(self) -> tuple[DepthMap, Rendering]:
        return self.depth.result(), self.picture.result()


def _known(value: Any) -> Future[Any]:
    known: Future[Any] = Future()
    known.set_result(value)
    return known


def _calibrated(flat: NDArray[Any]) -> Calibration:
    from lfcal import calibrate

    return calibrate(flat)


def _analysed(flat: NDArray[Any], camera: Calibration, preset: str, before: _Frame) -> DepthMap:
    return analyze(flat, camera, preset, previous=(before.flat, before.depth.result()))


def _drawn(flat: NDArray[Any], camera: Calibration, depth: Future[DepthMap], before: _Frame) -> Rendering:
    return render(flat, camera, depth.result(), previous=(before.flat, *before.answer()))


def _by_turns(
    flats: Iterable[NDArray[Any]],
    camera: Calibration,
    preset: str,
    earlier: NDArray[Any],
    depth: DepthMap,
    picture: Rendering,
) -> Iterator[tuple[DepthMap, Rendering]]:
    for flat in flats:
        after = analyze(flat, camera, preset, previous=(earlier, depth))
        picture = render(flat, camera, after, previous=(earlier, depth, picture))
        earlier, depth = flat, after
        yield depth, picture
