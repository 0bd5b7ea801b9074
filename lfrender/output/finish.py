"""What is done to pictures before they are written: brightness, white balance, tone curve, bits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

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
from ..runtime.types import AnyPath, Entries, Triple
from .formats import FORMATS, PictureFormat

__all__ = ["FILM_WHITE", "Finish", "flat_picture", "to_display"]

_NONE = (1.0, 1.0, 1.0)
# White of films of 16 bits, which FFmpeg counts as 8 bits times 256, both ways. Frames of films keep
# their values.
FILM_WHITE = 0xFF00
_DEEP_WHITE = 0xFFFF


def flat_picture(flat: Array, calibration: Calibration) -> Rendering:
    """A flat (h, w) or (h, w, C), or a part of it, as a picture with a pixel for each of its own."""
    seen = np.ones(flat.shape[:2], bool)
    return finish_picture(flat, seen, np.eye(2, 3), calibration.lattice.pitch, flat, calibration)


def to_display(picture: Rendering) -> Array:
    """The pixels of a picture with 8 bits for a display."""
    return Finish("picture.webp").apply(picture).image


@dataclass(frozen=True)
class Finish:
    """What is done to all pictures of a result before they are written.

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
    quality : int, optional
        Of formats that have one, 1 to 100.
    encoded : bool, optional
        Whether the values of the pictures are encoded, if something else tells it than they.
    gain : float, optional
        Gain on the light of all pictures; None where no picture was `measured`.
    balance : (float, float, float)
        Further gains of red, green and blue.
    source : str
        Where the white balance was found, for people.

    Examples
    --------
    >>> import lfrender
    >>> picture = lfrender.render(*lfrender.data.example(), scale=6)
    >>> Finish("picture.jpg", exposure=1.0).measured(picture).gain
    2.0
    """

    path: AnyPath
    exposure: Exposure | None = None
    tone: Tone = "auto"
    white_balance: WhiteBalance = "auto"
    eight_bits: bool = False
    quality: int | None = None
    encoded: bool | None = None
    gain: float | None = None
    balance: Triple = _NONE
    source: str = ""

    def __post_init__(self) -> None:
        check_choice(self.tone, Tone, "tone")
        gains: Any = self.white_balance
        if gains in ("auto", "none"):
            return
        if isinstance(gains, str) or len(gains) != 3 or not min(gains) > 0:
            wanted = "'auto', 'none' or three positive gains"
            raise ValueError(f"white_balance must be {wanted}, got {gains!r}")

    @property
    def _format(self) -> PictureFormat:
        return FORMATS.get(Path(self.path).suffix.lower(), FORMATS[".tif"])

    def is_encoded(self, picture: Rendering) -> bool:
        """Whether the values of a picture are encoded before anything is done to them."""
        stated = picture.encoded if self.encoded is None else self.encoded
        return is_encoded(picture.image.dtype, stated)

    def measured(self, picture: Any) -> Finish:
        """This finish with gain and white balance, as a picture needs them.

        It stays as it is if another was measured before; plain pixels need none.
        """
        if self.gain is not None or not isinstance(picture, Rendering):
            return self
        encoded = self.is_encoded(picture)
        balance = _NONE
        source = ""
        factors: Any = 1.0
        if picture.image.shape[2:] == (3,):
            balance, source = self._find_balance(picture, encoded)
            factors = balance
        exposure = self.exposure
        if exposure is None and not self._format.display:
            exposure = 0.0
        gain = exposure_gain(picture.image, picture.white, exposure, encoded, factors)
        return replace(self, gain=gain, balance=balance, source=source)

    def _find_balance(self, picture: Rendering, encoded: bool) -> tuple[Triple, str]:
        """Gains of red, green and blue, and where they come from."""
        if not isinstance(self.white_balance, str):
            return self.white_balance, ""
        if self.white_balance == "none" or picture.white_balance is None:
            return _NONE, ""
        if picture.white_balance:
            return picture.white_balance, "by the white image"
        found = grey_world(picture.image, picture.white, encoded)
        return found, "so that the picture is grey on the average"

    def apply(self, picture: Rendering) -> Rendering:
        """A picture as it is to be written, measured by itself if none was before."""
        known = self.measured(picture)
        gains: Any = known.gain
        if picture.image.shape[2:] == (3,) and known.balance != _NONE:
            gains = gains * np.array(known.balance)
        encoded = self.is_encoded(picture)
        image, srgb = self._convert(picture.image, encoded, picture.white, gains)
        white = picture.white
        if srgb or image.dtype != picture.image.dtype:
            white = None
        return replace(picture, image=image, white=white, encoded=srgb, white_balance=None)

    def apply_to_all(self, pictures: Iterable[Rendering]) -> Iterator[Rendering]:
        """Pictures as they are to be written, measured by the first of them."""
        known = self
        for picture in pictures:
            known = known.measured(picture)
            yield known.apply(picture)

    def apply_to_pixels(self, pixels: Array) -> Array:
        """Plain pixels as they are to be written: they keep their brightness and their colours."""
        # What cannot be a picture is refused by the writer.
        if pixels.dtype.name not in ("uint8", "uint16", "float32"):
            return pixels
        return self._convert(pixels, is_encoded(pixels.dtype, self.encoded))[0]

    def _target(self, dtype: np.dtype, encoded: bool) -> tuple[np.dtype, bool]:
        """The type of the pixels that are written, and whether these are encoded."""
        kind = self._format
        written = dtype
        if self.eight_bits or kind.reduces(dtype.name):
            deep = kind.film and "uint16" in kind.pixel_types and not self.eight_bits
            written = np.dtype(np.uint16 if deep else np.uint8)
        if self.tone == "auto":
            return written, encoded or kind.display or written != dtype
        return written, self.tone == "srgb"

    def _convert(
        self, pixels: Array, encoded: bool, white: float | None = None, gains: Any = 1.0
    ) -> tuple[Array, bool]:
        """Pixels of the type and tone that are written, and whether they are encoded."""
        dtype, srgb = self._target(pixels.dtype, encoded)
        top = None
        changed = (white_of(pixels, white), encoded) != (_DEEP_WHITE, srgb)
        if self._format.film and dtype == np.uint16 and changed:
            top = FILM_WHITE
        options = {"white": white, "gain": gains, "encoded": encoded, "top": top}
        return apply_tone(pixels, dtype, srgb, **options), srgb

    def entries(self, shown: Rendering) -> Entries:
        """What a file says of a picture that was finished."""
        entries: Entries = {"tone": "srgb" if shown.encoded else "linear"}
        if self.gain != 1:
            entries["exposure_gain"] = self.gain
        if self.balance != _NONE:
            entries["white_balance"] = list(self.balance)
        return entries

    def _describe_change(self, picture: Rendering) -> Iterator[str]:
        """A sentence about bits and curve, if a picture gets others than it has."""
        dtype = picture.image.dtype
        encoded = self.is_encoded(picture)
        written, srgb = self._target(dtype, encoded)
        start = "Written"
        if written != dtype:
            full = white_of(picture.image, picture.white)
            start = f"Written with 8 bits: 0 to {full:g} became 0 to 255"
        if srgb and not encoded:
            yield f"{start} by the curve of sRGB; --tone linear writes in proportion to light."
        elif encoded and not srgb:
            yield f"{start} in proportion to light, out of the curve of sRGB."
        elif written != dtype:
            yield f"{start}."

    def sentences(self, picture: Rendering | None = None) -> list[str]:
        """What is done to the pictures, of which one may be given, for people."""
        told = [] if picture is None else list(self._describe_change(picture))
        gain = self.gain or 1.0
        if gain != 1:
            told.append(
                f"Brightness times {gain:.3g} ({math.log2(gain):+.1f} EV of light); --exposure 0 "
                "leaves it as it is."
            )
        elif self.exposure == "auto":
            told.append("Brightness as it is: the picture is bright already.")
        if self.balance != _NONE:
            factors = ", ".join(f"{one:.2f}" for one in self.balance)
            why = f" ({self.source}; --white-balance none keeps the colours of the sensor)"
            told.append(f"Red, green and blue times {factors}{why if self.source else ''}.")
        return told
