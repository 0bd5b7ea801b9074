"""What all tests share: the benchmarks, and the data that may lie beside the repository or not."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

# Examples take longer on a busy machine.
settings.register_profile("busy", deadline=None)
settings.load_profile("busy")

# As the commands do: matrices are small, and threads that wait for each other double the time. Worker
# processes inherit this before they load NumPy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_ROOT = Path(__file__).resolve().parents[1]
_SHARED = _ROOT.parent / "shared"

# The benchmarks are not installed. Behind whatever is, so that the packages tested are the
# installed ones.
sys.path.append(str(_ROOT))


def pytest_sessionstart(session):
    """Compile kernels once per run, on all cores, before the processes that run the tests need
    them.
    """
    config = session.config
    if (
        hasattr(config, "workerinput")
        or not getattr(config.option, "tx", None)
        or config.option.collectonly
    ):
        return
    from benchmarks.kernels import discard_outdated
    from lfcal.runtime.compilation.compile_ahead import compile_ahead

    discard_outdated()
    compile_ahead()


@pytest.fixture(scope="session")
def shared():
    """Gives a file or folder of the captures and ray-traced flats beside the repository, or skips
    the test.
    """

    def find(*parts: str) -> Path:
        path = _SHARED.joinpath(*parts)
        if not path.exists():
            pytest.skip(
                f"{Path(*parts)} is not there: no folder 'shared' with it beside the repository"
            )
        return path

    return find


@pytest.fixture(scope="session")
def house():
    """A small simulated capture with both modes, and its truth."""
    from data_synth import SCENES, Camera, simulate

    camera = Camera.design(size=(420, 330), pitch=20.3, lattice="hex", rotation=1.3)
    return simulate(SCENES["house"](camera), camera, samples=16, seed=4)


@pytest.fixture(scope="session")
def house_files(house, tmp_path_factory):
    """The folder of that capture: flat.png, white.png, camera.json (true)."""
    folder = tmp_path_factory.mktemp("house")
    house.save(folder)
    return folder


@pytest.fixture(scope="session")
def house_camera(house):
    """The camera calibrated from that capture."""
    import lfcal

    return lfcal.calibrate(house.flat)


@pytest.fixture(scope="session")
def house_white_camera(house):
    """The camera calibrated from its white image."""
    import lfcal

    return lfcal.calibrate(house.white)
