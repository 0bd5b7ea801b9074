"""How long threads stay awake between two kernels: those of GNU OpenMP go on for some milliseconds, for nothing.

Within a frame kernels follow each other after some hundredths of a millisecond. Between the steps of a calibration a
thread that sleeps costs no time, and one that waits costs as much of the processor as one that works.
"""

from __future__ import annotations

import os

__all__: list[str] = []

# Turns of the loop in which a thread waits before it sleeps, measured as 0.1 to 0.15 ms: with fewer, frames take
# longer. It counts when the first kernel is run.
_TURNS = 20_000

if "OMP_WAIT_POLICY" not in os.environ:
    os.environ.setdefault("GOMP_SPINCOUNT", str(_TURNS))
