"""What is done to pictures before they are written: brightness, white balance, tone curve, bits."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from lfcal import Calibration
from lfcal.runtime.arrays import Array, white_of
from lfcal.runtime.light.tone import (
    Exposure,
    WhiteBalance,
    apply_tone,
    exposure_gain,
    grey_world,
    is_encoded,
)

from ..data.rendering import Rendering, finish_picture
from ..runtime.choices import Tone, check_choice
from ..runtime.types import AnyPath
from .formats import FORMATS

__all__ = ["FILM_WHITE", "Finish", "to_display"]

_Picture = TypeVar("_Picture")
_NONE = (1.0, 1.0, 1.0)
# White of films of 16 bits, which FFmpeg counts as 8 bits times 256, both ways. Frames of films keep
# their values.
FILM_WHITE = 0xFF00
_DEEP_WHITE = 0xFFFF


def _as_picture(flat: Array, calibration: Calibration) -> Rendering:
    """A flat as a picture with a pixel for each of its own."""
    seen = np.ones(flat.shape[:2], bool)
    return finish_picture(flat, seen, np.eye(2, 3), calibration.lattice.pitch, flat, calibration)


def to_display(picture: Rendering) -> Array:
    """The pixels of a picture with 8 bits for a display."""
    return Finish("picture.webp").apply(picture).image


def _check_gains(gains: Any) -> None:
    """Raise a ValueError unless a white balance is three positive gains."""
    if isinstance(gains, str) or len(gains) != 3 or not min(gains) > 0:
        wanted = "'auto', 'none' or three positive gains"
        raise ValueError(f"white_balance must be {wanted}, got {gains!r}")


class Finish:
    """Finishes all pictures of a result in the same way, as the first one needs it.

    Parameters
    ----------
    path : path-like
        Its suffix is the format, which may hold 8 bits only, or be made for displays.
    exposure : float or "auto", optional [EV]
        None is `"auto"` for linear pictures in formats for displays, and 0 for all others.
    tone : {"auto", "linear", "srgb"}
        `"auto"` encodes linear pictures by the curve of sRGB in formats for displays, and where
        they get 8 bits; all others keep their values.
    white_balance : {"auto", "none"} or (float, float, float)
        Of pictures that come from a colour filter mosaic: by its white image, or else so that the
        first picture is grey on the average; numbers apply to all pictures in colour.
    eight_bits : bool
        Whether the pictures get 8 bits in every format.
    encoded : bool, optional
        Whether the values of the pictures are encoded, if something else tells it than they.
    known : (float, (float, float, float)), optional
        Gain and white balance that were measured before.
    """

    def __init__(
        self,
        path: AnyPath,
        *,
        exposure: Exposure | None = None,
        tone: Tone = "auto",
        white_balance: WhiteBalance = "auto",
        eight_bits: bool = False,
        encoded: bool | None = None,
        known: tuple[float, tuple[float, float, float]] | None = None,
    ) -> None:
        self._format = FORMATS.get(Path(path).suffix.lower(), FORMATS[".tif"])
        if exposure is None and not self._format.display:
            exposure = 0.0
        check_choice(tone, Tone, "tone")
        if white_balance not in ("auto", "none"):
            _check_gains(white_balance)
        self._exposure = exposure
        self._tone = tone
        self._white_balance = white_balance
        self._eight_bits = eight_bits
        self._encoded = encoded
        #: Gain on light, and further gains of red, green and blue.
        self.known = known
        self._source = ""  # of the white balance
        self._change = ""  # of bits and curve
        #: Whether the last picture got another curve than it had.
        self.changes_curve = False
        self._written: Tone | None = None

    def measure(self, picture: Rendering) -> tuple[float, tuple[float, float, float]]:
        """Gain and white balance of all pictures, by this one if it is the first."""
        if self.known is None:
            image = picture.image
            encoded = self._is_encoded(picture)
            balance = self._find_balance(picture, encoded)
            factors: Any = balance if image.shape[2:] == (3,) else 1.0
            gain = exposure_gain(image, picture.white, self._exposure, encoded, factors)
            self.known = gain, balance
        return self.known

    def measure_flat(
        self, flat: Array, calibration: Calibration
    ) -> tuple[float, tuple[float, float, float]]:
        """As `measure`, by a flat (h, w) or (h, w, C) in place of a picture of it."""
        return self.measure(_as_picture(flat, calibration))

    def show(self, pixels: Array, calibration: Calibration) -> Array:
        """A flat (h, w) or (h, w, C), or a part of it, as it is to be shown."""
        return self.apply(_as_picture(pixels, calibration)).image

    def _is_encoded(self, picture: Rendering) -> bool:
        stated = picture.encoded if self._encoded is None else self._encoded
        return is_encoded(picture.image.dtype, stated)

    def _find_balance(self, picture: Rendering, encoded: bool) -> tuple[float, float, float]:
        if picture.image.shape[2:] != (3,) or self._white_balance == "none":
            return _NONE
        if self._white_balance != "auto":
            return self._white_balance
        if picture.white_balance is None:
            return _NONE
        if picture.white_balance:
            self._source = "by the white image"
            return picture.white_balance
        self._source = "so that the picture is grey on the average"
        return grey_world(picture.image, picture.white, encoded)

    def apply(self, picture: _Picture) -> _Picture:
        """A picture, or plain pixels, as they are to be written.

        Plain pixels keep their brightness and their colours.
        """
        if not isinstance(picture, Rendering):
            pixels = np.asarray(picture)
            # What cannot be a picture is refused by the writer.
            if pixels.dtype.name not in ("uint8", "uint16", "float32"):
                return picture
            return self._convert(pixels, is_encoded(pixels.dtype, self._encoded))[0]  # type: ignore[return-value]
        gain, balance = self.measure(picture)
        gains: Any = gain
        if picture.image.shape[2:] == (3,) and balance != _NONE:
            gains = np.multiply(gain, balance)
        encoded = self._is_encoded(picture)
        image, srgb = self._convert(picture.image, encoded, picture.white, gains)
        white = picture.white
        if srgb or image.dtype != picture.image.dtype:
            white = None
        self._written = "srgb" if srgb else "linear"
        return replace(picture, image=image, white=white, encoded=srgb, white_balance=None)

    def _convert(
        self, pixels: Array, encoded: bool, white: float | None = None, gains: Any = 1.0
    ) -> tuple[Array, bool]:
        """Pixels of the type and tone that are written, and whether they are encoded."""
        dtype = pixels.dtype
        if self._eight_bits or self._format.reduces(dtype.name):
            deep = self._format.film and "uint16" in self._format.pixel_types
            dtype = np.dtype(np.uint16 if deep and not self._eight_bits else np.uint8)
        srgb = self._tone == "srgb"
        if self._tone == "auto":
            srgb = encoded or self._format.display or dtype != pixels.dtype
        full = white_of(pixels, white)
        self.changes_curve = srgb != encoded
        self._change = ""
        if dtype != pixels.dtype:
            self._change = f"Written with 8 bits: 0 to {full:g} became 0 to 255"
            if srgb == encoded:
                self._change += "."
        if srgb != encoded:
            curve = "by the curve of sRGB; --tone linear writes in proportion to light."
            if encoded:
                curve = "in proportion to light, out of the curve of sRGB."
            self._change = f"{self._change or 'Written'} {curve}"
        top = None
        if self._format.film and dtype == np.uint16 and (full, encoded) != (_DEEP_WHITE, srgb):
            top = FILM_WHITE
        options = {"white": white, "gain": gains, "encoded": encoded, "top": top}
        return apply_tone(pixels, dtype, srgb, **options), srgb

    @property
    def entries(self) -> dict[str, Any]:
        """What a file says of the pictures, once one was finished."""
        entries: dict[str, Any] = {}
        if self._written is not None:
            entries["tone"] = self._written
        gain, balance = self.known or (1.0, _NONE)
        if gain != 1:
            entries["exposure_gain"] = gain
        if balance != _NONE:
            entries["white_balance"] = list(balance)
        return entries

    @property
    def sentences(self) -> list[str]:
        """What was done to the pictures, for people."""
        told = [self._change] if self._change else []
        gain, balance = self.known or (1.0, _NONE)
        if gain != 1:
            told.append(
                f"Brightness times {gain:.3g} ({math.log2(gain):+.1f} EV of light); --exposure 0 "
                "leaves it as it is."
            )
        elif self._exposure == "auto":
            told.append("Brightness as it is: the picture is bright already.")
        if balance != _NONE:
            factors = ", ".join(f"{one:.2f}" for one in balance)
            why = f" ({self._source}; --white-balance none keeps the colours of the sensor)"
            told.append(f"Red, green and blue times {factors}{why if self._source else ''}.")
        return told
