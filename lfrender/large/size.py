"""Which flats are worked on by tiles; imports nothing heavy, because commands check this first."""

from __future__ import annotations

import os
from pathlib import Path

from lfcal import LightFieldError
from lfcal.runtime.image_formats import TIFF_SUFFIXES

__all__ = ["is_large"]


def is_large(path: str | os.PathLike[str], least_bytes: float = 1e8) -> bool:
    """Whether a flat can be read in parts and has more than `least_bytes`; smaller ones are faster as a whole."""
    flat = Path(path)
    if flat.suffix.lower() not in TIFF_SUFFIXES and not flat.is_dir():
        return False
    from lfcal import open_flat

    try:
        # A compressed file that is a hundred times smaller need not be opened: its flat is smaller too.
        if flat.is_file() and flat.stat().st_size < least_bytes / 100:
            return False
        with open_flat(flat) as source:
            return source.in_parts and source.nbytes > least_bytes
    except (LightFieldError, OSError):
        # Reading the file will report what is wrong with it.
        return False
