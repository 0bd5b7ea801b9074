"""Limit the time that GNU OpenMP threads spin between two kernels, by default some milliseconds.

Within a frame kernels follow each other after some hundredths of a millisecond, so spinning pays. Between the steps of
a calibration a spinning thread only takes processor time from others.
"""

from __future__ import annotations

import os

__all__: list[str] = []

# Spins before a thread sleeps, measured as 0.1 to 0.15 ms; with fewer, frames take longer. Read by OpenMP when the
# first kernel runs.
_SPIN_COUNT = 20_000

if "OMP_WAIT_POLICY" not in os.environ:
    os.environ.setdefault("GOMP_SPINCOUNT", str(_SPIN_COUNT))
