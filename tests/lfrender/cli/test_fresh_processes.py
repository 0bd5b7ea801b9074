"""Commands end, whatever form a flat has: in fresh processes, as users start them."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import tifffile
from PIL import Image

import lfcal


def test_flats_that_are_read_at_once_hang_no_command(house_files, tmp_path):
    flat = lfcal.read_flat(house_files / "flat.png")
    Image.fromarray(flat).save(tmp_path / "flat.ppm")
    Image.fromarray(flat).save(tmp_path / "flat.bmp")
    tifffile.imwrite(tmp_path / "flat.tif", (flat / 255).astype(np.float32), photometric="rgb")

    def render(name):
        command = [
            sys.executable,
            "-m",
            "lfrender.cli.main",
            "render",
            str(tmp_path / name),
            "-c",
            str(house_files / "camera.json"),
            "-o",
            str(tmp_path / f"{name}.picture.tif"),
            "--preset",
            "fast",
            "--quiet",
        ]
        return subprocess.run(command, capture_output=True, text=True, timeout=300)

    with ThreadPoolExecutor(2) as pool:
        runs = list(pool.map(render, ["flat.ppm", "flat.bmp", "flat.tif"]))
    assert [(run.returncode, run.stderr) for run in runs] == [(0, "")] * len(runs)
