"""Centres on white images by the other tools plenopticam and plenpy, where installed.

Both are made for unfocused cameras, whose microimages are pixels of views. They have no patch size,
so their depth and rendering cannot be compared.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import lfcal

from ..white_images import WhiteImage
from .measure import Row

__all__ = ["measure_peers", "peers_of", "white_cases"]

_SCRIPT = Path(__file__).with_name("peer_centres.py")
_THREADS = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
# Centres further off than this share of the pitch are of no microimage.
_HIT = 0.4


def white_cases() -> dict[str, WhiteImage]:
    """White images by name: as small apertures of lenses give them, which both tools are made for,
    and flat discs.
    """
    common = {"pitch": 14.3, "degrees": 0.3, "size": (800, 600)}
    return {
        "soft discs": WhiteImage(soft=9.0, inner=0.5, fill=0.97, **common),  # type: ignore[arg-type]
        "flat discs": WhiteImage(**common),  # type: ignore[arg-type]
    }


def peers_of(python: str) -> dict[str, str]:
    """Versions of the tools that are installed for that Python; empty where it cannot be run."""
    try:
        done = subprocess.run(
            [python, str(_SCRIPT)], capture_output=True, text=True, timeout=60, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return {}
    found: dict[str, str] = json.loads(done.stdout)
    return found


def measure_peers(python: str = sys.executable, limit: float = 120.0) -> Iterator[Row]:
    """Ours, and all tools that are installed for that Python, on `white_cases`; nothing where there
    is none.

    Each is ended after `limit` seconds.
    """
    peers = peers_of(python)
    for name, case in white_cases().items() if peers else ():
        white = case.image()
        yield _row(name, "lfcal", case, *_ours(white))
        for peer, version in peers.items():
            centres, spent, note = _theirs(python, peer, white, case.pitch, limit)
            yield _row(name, f"{peer} {version}", case, centres, spent, note)


def _ours(white: NDArray) -> tuple[NDArray[np.float64], float, str]:
    lfcal.calibrate(white)
    start = time.process_time()
    found = lfcal.calibrate(white)
    return found.lattice.centres(), time.process_time() - start, ""


def _theirs(
    python: str, peer: str, white: NDArray, pitch: float, limit: float
) -> tuple[NDArray[np.float64], float, str]:
    """Centres (n, 2) [px] without any where it fails, CPU time [s] and why it failed."""
    none = np.empty((0, 2))
    with tempfile.TemporaryDirectory() as folder:
        light = Path(folder) / "white.npy"
        centres = Path(folder) / "centres.npy"
        np.save(light, white / np.iinfo(white.dtype).max)
        command = [python, str(_SCRIPT), peer, str(light), str(pitch), str(centres)]
        environment = {**os.environ, **_THREADS}
        environment.pop("PYTHONPATH", None)
        try:
            done = subprocess.run(
                command,
                capture_output=True,
                text=True,
                timeout=limit,
                check=False,
                cwd=folder,
                env=environment,
            )
        except subprocess.TimeoutExpired:
            return none, float("nan"), f"no answer within {limit:g} s"
        if done.returncode:
            return none, float("nan"), done.stderr.strip().rpartition("\n")[2][:200]
        return np.load(centres), float(done.stdout.split()[-1]), ""


def _row(
    case: str, method: str, truth: WhiteImage, centres: NDArray, spent: float, note: str
) -> Row:
    """Errors over the centres that are of a microimage, and the share of the whole microimages that
    have one.
    """
    width, height = truth.size
    megapixels = width * height / 1e6
    unit = _remap_time(truth.size)
    errors = {}
    if len(centres):
        index = truth.index_of(centres)
        off = centres - truth.centres(index)
        hit = np.hypot(*off.T) < _HIT * truth.pitch
        whole = lfcal.Lattice(truth.origin, truth.basis, truth.size, truth.pitch / 2)
        inside = whole.centres()
        edge = truth.pitch / 2
        inside = inside[((inside >= edge) & (inside <= np.array(truth.size) - 1 - edge)).all(1)]
        wanted = {tuple(row) for row in truth.index_of(inside).astype(int).tolist()}
        seen = {tuple(row) for row in index[hit].astype(int).tolist()}
        rms = float(np.sqrt((off[hit] ** 2).sum(1).mean())) if hit.any() else float("inf")
        errors = {"centre RMS px": rms, "centres found": len(wanted & seen) / len(wanted)}
    return Row("peers", method, case, spent / megapixels, spent / unit, errors, note)


def _remap_time(size: tuple[int, int]) -> float:
    """CPU time [s] of `cv2.remap` of a grey image of 8 bits onto a grid of its own size, the least
    of several.
    """
    x, y = np.meshgrid(np.arange(size[0], dtype=np.float32), np.arange(size[1], dtype=np.float32))
    image = np.zeros(size[::-1], np.uint8)
    least = np.inf
    for _ in range(20):
        start = time.process_time()
        cv2.remap(image, x + 0.3, y + 0.3, cv2.INTER_LINEAR)
        least = min(least, time.process_time() - start)
    return float(max(least, 1e-9))
