"""Microimage centres by another tool, as a script that needs only that tool.

python peer_centres.py                                   # versions of the tools installed, as JSON
python peer_centres.py NAME WHITE.npy PITCH CENTRES.npy  # prints the CPU time [s]
"""

from __future__ import annotations

import json
import sys
import time
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any
from unittest.mock import MagicMock

import numpy as np

# Tools, and the way to calibrate of each that is the most exact on white images like those that it
# is made for.
_TOOLS = {"plenopticam": "grid-fit", "plenpy": "own"}
# Sensor distance over focal length of plenpy's own method: more than 1, by so little that nothing
# else changes.
_MAGNIFICATION = 1.01


def installed() -> dict[str, str]:
    """Versions of the tools that this Python has."""
    found = {}
    for name in _TOOLS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _plenopticam(white: Any, pitch: float) -> Any:
    """(n, 2) centres x, y [px]: its calibrator, told the pitch, which it does not find on small
    images.
    """
    config = import_module("plenopticam.cfg").PlenopticamConfig()
    config.default_values()
    for option in (config.opt_prnt, config.opt_dbug):
        config.params[option] = False
    config.params[config.cal_meth] = _TOOLS["plenopticam"]
    # It would write beside its settings.
    config.save_cal_data = lambda **_: None
    calibrator = import_module("plenopticam.lfp_calibrator").LfpCalibrator(65535 * white, config)
    calibrator._M = round(pitch)
    calibrator.main()
    return np.array(config.calibs[config.mic_list])[:, [1, 0]]


def _plenpy(white: Any, pitch: float) -> Any:
    """(n, 2) centres x, y [px]: the grid that its light field cameras estimate, without their
    folders and files.
    """
    for name in ("torch", "torchvision", "torchvision.transforms"):
        # All of its cameras are imported together, and one of them needs these.
        try:
            import_module(name)
        except ImportError:
            # SciPy asks of what it is given whether it is one of its tensors.
            sys.modules[name] = MagicMock(Tensor=type("Tensor", (), {}))
    base = import_module("plenpy.cameras.abstract_lightfield_camera").AbstractLightFieldCamera
    kind = type("Camera", (base,), {name: lambda *_: None for name in base.__abstractmethods__})
    camera: Any = object.__new__(kind)
    camera._gridType, camera._microlensSize, camera._microlensRadius = "hex", pitch, int(pitch / 2)
    grid = camera._get_ideal_grid_params(
        method=_TOOLS["plenpy"], wi=white, args={"lam_est": _MAGNIFICATION}
    )
    points = import_module("plenpy.utilities.grids").HexGrid(grid).gridPoints
    return np.asarray(points).reshape(-1, 2)[:, ::-1]


def main(arguments: list[str]) -> None:
    """Print the versions, or write the centres that a tool finds."""
    if not arguments:
        print(json.dumps(installed()))
        return
    name, white, pitch, centres = arguments
    picture = np.load(white).astype(float)
    start = time.process_time()
    found = {"plenopticam": _plenopticam, "plenpy": _plenpy}[name](picture, float(pitch))
    spent = time.process_time() - start
    np.save(centres, found)
    # They print as they go: the last line counts.
    print(f"\n{spent}")


if __name__ == "__main__":
    main(sys.argv[1:])
