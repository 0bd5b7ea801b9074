"""Speed of live pictures: `python -m benchmarks.live_speed FRAMES [SECONDS]`, by default 20 seconds
each.

The first frames of FRAMES (a folder, a video) are held in memory and given ten times a second, to
and fro: grey, behind a Bayer mosaic, and in colours, each of 8 bits; as they are, and as a still
scene, the first one with noise of one grey level. A client asks for pictures over the loopback, as
the page does. Printed are pictures a second, the median and the 95th percentile of the time from
the arrival of a frame to its JPEG [ms], processor time [cores] and memory [MB].
"""

from __future__ import annotations

import http.client
import itertools
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender
from lfcal.runtime.light.tone import to_eight_bits
from lfrender.live.grabber import Grabber
from lfrender.live.server import LiveServer
from lfrender.live.session import Session
from lfrender.live.sources import Shot

_RATE = 10.0
_FRAMES = 12


def _kinds(flat: NDArray[Any]) -> dict[str, NDArray[np.uint8]]:
    """A colour flat in grey, behind RGGB filters, and as it is."""
    mosaic = flat[:, :, 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = flat[::2, ::2, 0], flat[1::2, 1::2, 2]
    return {"grey": np.ascontiguousarray(flat[:, :, 1]), "Bayer": mosaic, "colour": flat}


def _play(frames: list[NDArray[Any]]) -> Iterator[Shot]:
    due = time.monotonic()
    for frame in itertools.cycle([*frames, *frames[-2:0:-1]]):
        time.sleep(max(0.0, due - time.monotonic()))
        due = max(due + 1 / _RATE, time.monotonic())
        yield Shot(frame.copy())


def _measure(
    frames: list[NDArray[Any]], camera: lfcal.Calibration, picture: str, seconds: float
) -> str:
    session = Session(Grabber(lambda: _play(frames)), lambda shot: camera, "fast", Path())
    session.start()
    latencies: list[float] = []
    with LiveServer(session, "benchmark") as server:
        client = http.client.HTTPConnection("127.0.0.1", server.port)
        after = 0
        start = np.inf
        used = 0.0
        pictures = 0
        while time.monotonic() < start + seconds:
            client.request("GET", f"/frame?kind={picture}&after={after}")
            response = client.getresponse()
            response.read()
            after = int(response.getheader("X-Frame") or after)
            pictures += 1
            # The first pictures load kernels, and tables of the camera.
            if pictures <= 10:
                start = time.monotonic()
                used = time.process_time()
            else:
                latencies.append(1e3 * session.latency)
        cores = (time.process_time() - used) / seconds
    session.close()
    memory = int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
    middle, most = np.quantile(latencies, [0.5, 0.95])
    rate = len(latencies) / seconds
    speed = f"{rate:5.1f} a second, {middle:5.0f} ms ({most:.0f} ms)"
    return f"{speed}, {cores:.1f} cores, {memory:.0f} MB"


def main() -> None:
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 20.0
    frames = [
        to_eight_bits(frame.read())
        for frame in itertools.islice(lfrender.open_frames([sys.argv[1]]), _FRAMES)
    ]
    camera = lfcal.calibrate(frames[0])
    noise = np.random.default_rng(1)
    for kind in ("grey", "Bayer", "colour"):
        of_kind = replace(camera, mosaic="RGGB" if kind == "Bayer" else None)
        moving = [_kinds(frame)[kind] for frame in frames]
        noisy = (moving[0] + noise.normal(0, 1, moving[0].shape) for _ in range(_FRAMES // 2))
        still = [np.clip(frame, 0, 255).astype(np.uint8) for frame in noisy]
        print(f"{kind:6} sharp still  {_measure(still, of_kind, 'sharp', seconds)}", flush=True)
        for picture in ("sharp", "focus", "traditional") if kind == "Bayer" else ("sharp",):
            print(
                f"{kind:6} {picture} moves  {_measure(moving, of_kind, picture, seconds)}",
                flush=True,
            )


if __name__ == "__main__":
    main()
