"""Lattices of pieces of flats beside those of the whole: `python -m benchmarks.pieces FLAT... [--share S] [--seed N]`.

Pieces of each flat, one from its middle and the others from anywhere, are calibrated alone. Printed are, for each that
is, its pitch, its confidence and how far its centres lie from those of the whole flat, else why it was refused.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from scipy.spatial import cKDTree

import lfcal

__all__ = ["main"]

_PIECES = 8


def main(arguments: list[str]) -> None:
    """Print one line for each piece, and how many of them were calibrated."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pieces", description=__doc__)
    parser.add_argument("flats", nargs="+")
    parser.add_argument("--share", type=float, default=0.5, help="of the width and of the height")
    parser.add_argument("--seed", type=int, default=1, help="of the places")
    options = parser.parse_args(arguments)
    rng, found = np.random.default_rng(options.seed), 0
    for path in options.flats:
        flat = lfcal.read_flat(path)
        whole = lfcal.calibrate(flat).lattice
        centres = cKDTree(whole.centres())
        size = (np.array(whole.image_size) * options.share).astype(int)
        room = np.array(whole.image_size) - size
        for corner in [room // 2, *rng.integers(0, room, (_PIECES - 1, 2))]:
            piece = flat[corner[1] : corner[1] + size[1], corner[0] : corner[0] + size[0]].copy()
            try:
                camera = lfcal.calibrate(piece)
            except lfcal.CalibrationError as error:
                print(f"{path.split('/')[-1]:24} {corner}  refused: {error}", flush=True)
                continue
            found += 1
            apart = centres.query(camera.lattice.centres() + corner)[0] / whole.pitch
            print(
                f"{path.split('/')[-1]:24} {corner}  pitch {camera.lattice.pitch:.3f} of {whole.pitch:.3f} px,"
                f" confidence {camera.confidence:.2f}, centres off by {np.median(apart):.3f} pitches in the median,"
                f" {apart.max():.3f} at most",
                flush=True,
            )
    print(f"{found} of {_PIECES * len(options.flats)} pieces calibrated")


if __name__ == "__main__":
    main(sys.argv[1:])
