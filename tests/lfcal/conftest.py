"""White images of known lattices for the tests of lfcal."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def whites() -> ModuleType:
    """The generator of white images, `_whites.py` beside this file."""
    name = "lfcal_test_whites"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name("_whites.py"))
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


@pytest.fixture(scope="session")
def drawn() -> type:
    """White images of the benchmark, whose centres and bound are known."""
    from benchmarks.white_images import WhiteImage

    return WhiteImage


@pytest.fixture
def set_downscale(monkeypatch):
    """Gives the functions of `detection.downscale` other limits."""
    from lfcal.detection import downscale

    def apply(**values: float) -> None:
        for name, value in values.items():
            monkeypatch.setattr(downscale, name.upper(), value)

    return apply


@pytest.fixture(scope="session")
def calibrated_white(drawn):
    """A white image of known light with hot pixels, and the calibration measured from it."""
    import lfcal

    truth = drawn("hexagonal", 20.3, 5.0, 26.0, size=(800, 600), hot=40)
    return truth, lfcal.calibrate(truth.image(), kind="white")
