"""Parts of a large flat as the kernels want them: with channels, and in colour behind a mosaic."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, CalibrationError, FlatSource

from ..flat.demosaicing import REACH, demosaic

__all__ = ["PartReader"]

_Part = tuple[int, int, int, int]


class PartReader:
    """A flat in a file with the camera that took it.

    Parameters
    ----------
    source : FlatSource
    calibration : Calibration
        Of the same image size, else CalibrationError.
    """

    def __init__(self, source: FlatSource, calibration: Calibration) -> None:
        size = source.shape[1], source.shape[0]
        if size != calibration.image_size:
            was, now = ("{} x {}".format(*pair) for pair in (calibration.image_size, size))
            raise CalibrationError(f"calibration is for images of {was} px, the flat has {now}; calibrate on this flat")
        self.source, self.calibration, self._size = source, calibration, size
        self._mosaic = calibration.mosaic is not None and len(source.shape) == 2
        self.channels = 3 if self._mosaic or len(source.shape) == 3 else 1
        #: Whether pictures have colours.
        self.colour = self.channels > 1

    def read(self, part: _Part) -> NDArray[Any]:
        """(h, w, C) pixels of `left, top, right, bottom`, as `check_flat` has them there."""
        return self._prepared(part, self._raw(part))

    def ahead(self, parts: Iterable[_Part]) -> Iterator[tuple[_Part, NDArray[Any]]]:
        """Each part with its pixels; the file is read for the next one meanwhile."""
        with ThreadPoolExecutor(1) as reader:
            waiting: tuple[_Part, Future[NDArray[Any]]] | None = None
            for part in parts:
                following = part, reader.submit(self._raw, part)
                if waiting is not None:
                    yield waiting[0], self._prepared(waiting[0], waiting[1].result())
                waiting = following
            if waiting is not None:
                yield waiting[0], self._prepared(waiting[0], waiting[1].result())

    def _raw(self, part: _Part) -> NDArray[Any]:
        return self.source.read(*self._wider(part))

    def _wider(self, part: _Part) -> _Part:
        """With what colours are interpolated from around it, from even places on."""
        if not self._mosaic:
            return part
        left, top, right, bottom = part
        width, height = self._size
        return (
            max(0, left - REACH) // 2 * 2, max(0, top - REACH) // 2 * 2, min(width, right + REACH),
            min(height, bottom + REACH),
        )  # fmt: skip

    def _prepared(self, part: _Part, raw: NDArray[Any]) -> NDArray[Any]:
        # Kernels with several threads must not run beside each other, so this is not done while reading ahead.
        if not self._mosaic:
            return raw if raw.ndim == 3 else raw[:, :, None]
        left, top, _, _ = self._wider(part)
        colour = demosaic(raw, self.calibration, (left, top))
        return np.ascontiguousarray(colour[part[1] - top : part[3] - top, part[0] - left : part[2] - left])
