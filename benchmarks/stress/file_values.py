"""Depth and camera files with wrong values: `python -m benchmarks.stress.file_values FOLDER
[COUNT]`.

`hypothesis` draws whole files in which one to three values are replaced. Each is refused in one
line, or gives the picture of the good file, or, without a checksum, one that its values state.
"""

from __future__ import annotations

import copy
import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import lfcal
import lfrender

from .file_faults import Fault

__all__ = ["camera_files", "depth_files", "fuzz_cameras", "fuzz_depths", "main"]

# Longest time of a file [s], and most memory of all of them [GB].
_TIME = 20.0
_MEMORY = 2.0
# Largest mean difference of two pictures of 8 bits that show the same.
_SAME_PICTURE = 1.0
_Array = NDArray[Any]
_VALUES: tuple[Any, ...] = (
    None,
    True,
    "",
    "\ud800",
    "x" * 3000,
    [],
    {},
    [[]],
    0,
    -1,
    0.5,
    1e9,
    1e30,
    1e300,
    10**400,
    -(10**400),
    float("nan"),
    float("inf"),
)
_NUMBERS = (0.0, -1.0, 1e9, 1e30, -1e30, np.nan, np.inf)
_CHANGES: tuple[Callable[[_Array], _Array], ...] = (
    lambda values: -values,
    lambda values: values[None],
    lambda values: values[:0] if values.ndim else values.astype(str),
    lambda values: values.ravel()[:1].reshape((1,) * values.ndim),
    lambda values: np.resize(values.astype(np.float32), (3000, 3000)),
    lambda values: np.resize(values.astype(np.float32), (3000,) * min(values.ndim, 2)),
    lambda values: values.T,
    lambda values: values[::-1] if values.ndim else values,
    lambda values: values.astype(np.complex64),
    lambda values: values.astype("U"),
    lambda values: values.astype(np.float16),
    lambda values: np.asfortranarray(values.astype(np.float64)),
    lambda values: values * 1.01,
    lambda values: values * 2,
    lambda values: values + 1,
    lambda values: np.array("\ud800"),
    lambda values: np.array([]),
)


def _places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all values in nested dictionaries and lists, of lists the first three."""
    found = [path]
    if isinstance(value, dict):
        for name, item in value.items():
            found += _places(item, (*path, name))
    if isinstance(value, list):
        for number, item in enumerate(value[:3]):
            found += _places(item, (*path, number))
    return found


@st.composite
def camera_files(draw: st.DrawFn, fields: dict[str, Any]) -> str:
    """The text of a camera file with these fields, of which one to three have other values."""
    data = copy.deepcopy(fields)
    for _ in range(draw(st.integers(1, 3))):
        *parents, last = draw(st.sampled_from(_places(data)[1:]))
        inside = data
        for name in parents:
            inside = inside[name]
        if isinstance(inside, dict) and draw(st.integers(0, 5)) == 0:
            del inside[last]
        else:
            inside[last] = draw(st.sampled_from(_VALUES))
    return json.dumps(data)


@st.composite
def depth_files(draw: st.DrawFn, arrays: dict[str, _Array]) -> dict[str, _Array]:
    """Arrays of a depth file, of which one to three have other values, types or shapes.

    Half of the files have no checksum.
    """
    data = dict(arrays)
    if draw(st.booleans()):
        del data["digest"]
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(sorted(data)))
        values = data[name]
        number = draw(st.sampled_from((None, *_NUMBERS)))
        if draw(st.integers(0, 7)) == 0:
            del data[name]
        elif number is None or values.dtype.kind not in "fiu":
            try:
                data[name] = np.asarray(draw(st.sampled_from(_CHANGES))(values))
            except (TypeError, ValueError):
                # No such change of this type, as of texts.
                data[name] = np.zeros((2, 2, 2))
        else:
            data[name] = np.array(values, np.float64)
            some = draw(st.sampled_from((slice(None), slice(0, 1)))) if values.ndim else ()
            data[name][some] = number
    return data


class _Scene:
    """A flat with camera, depth and picture."""

    def __init__(self) -> None:
        self.flat, self.camera, _ = lfrender.data.example()
        self.depth = lfrender.analyze(self.flat, self.camera)
        self.picture = self.draw(self.camera, self.depth)

    def draw(self, camera: lfcal.Calibration, depth: lfrender.DepthMap) -> _Array:
        return lfrender.render(self.flat, camera, depth, scale=14).image.astype(np.float64)

    def is_other(self, picture: _Array) -> bool:
        same = picture.shape == self.picture.shape
        return not same or np.abs(picture - self.picture).mean() > _SAME_PICTURE


def _try(number: int, use: Callable[[], str]) -> tuple[list[Fault], bool]:
    """The faults of a file, and whether it was refused."""
    start = time.process_time()
    refused = False
    what = ""
    try:
        what = use()
    except lfcal.LightFieldError as error:
        refused = True
        # A message that cannot be encoded cannot be printed.
        if len(str(error).encode(errors="surrogatepass").splitlines()) != 1:
            what = f"more than one line: {error!r}"
        try:
            str(error).encode()
        except UnicodeEncodeError:
            what = f"cannot be printed: {error!r}"
    except Exception as error:
        what = repr(error)[:200]
    spent = time.process_time() - start
    if spent > _TIME:
        what = f"{spent:.0f} s"
    return [Fault("file", number, what)] if what else [], refused


def _fuzz(
    strategy: st.SearchStrategy[Any], count: int, first: int, use: Callable[[Any], str]
) -> tuple[int, int, list[Fault]]:
    """Numbers of files and of refused ones, and the faults."""
    tried = 0
    refused = 0
    faults: list[Fault] = []

    @seed(first)
    @settings(
        max_examples=count,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def draw(case: Any) -> None:
        nonlocal tried, refused
        found, no = _try(tried, lambda: use(case))
        tried += 1
        refused += no
        faults.extend(found)

    draw()
    return tried, refused, faults


def fuzz_cameras(folder: Path, count: int, first: int = 0) -> tuple[int, int, list[Fault]]:
    """Load, show and draw with camera files that have wrong values.

    Gives the numbers of files and of refused ones, and the faults: errors that are none of the
    project's own, and other pictures of cameras whose check finds no problem.
    """
    scene = _Scene()
    sample = lfrender.data.house(size=(400, 300), samples=2)
    white = lfcal.calibrate(sample.white, kind="white").to_dict()
    optics = lfcal.Optics(50, 58, 0.7, 0.005, covariance=np.eye(14)).to_dict()
    own = scene.camera.to_dict()
    own |= {"evidence": white["evidence"], "optics": optics, "errors": white["errors"]}
    path = folder / "camera.json"

    def use(text: str) -> str:
        path.write_text(text, encoding="utf-8")
        camera = lfcal.load(path)
        camera.save(folder / "again.json")
        repr(camera)
        if camera.gain_map is not None:
            camera.gain()
        if camera.evidence is not None:
            camera.evidence.describe()
        if camera.image_size != scene.camera.image_size:
            return ""
        depth = scene.depth
        if camera.optics is not None:
            depth.distance_error(camera)
        picture = scene.draw(camera, depth)
        if scene.is_other(picture) and lfcal.check_camera(scene.flat, camera).problem is None:
            return "another picture"
        return ""

    half = count // 2
    a = _fuzz(camera_files(own), half, first, use)
    b = _fuzz(camera_files(white), count - half, first, use)
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def fuzz_depths(folder: Path, count: int, first: int = 0) -> tuple[int, int, list[Fault]]:
    """Load, show and draw depth files that have wrong values; results as of `fuzz_cameras`.

    Another picture is a fault where the file has the checksum of its arrays.
    """
    scene = _Scene()
    whole = folder / "whole.npz"
    scene.depth.save(whole)
    with np.load(whole) as file:
        arrays = dict(file)
    path = folder / "depth.npz"

    def use(data: dict[str, _Array]) -> str:
        np.savez(path, **data)  # type: ignore[arg-type]
        depth = lfrender.DepthMap.load(path)
        depth._repr_html_()
        picture = scene.draw(scene.camera, depth)
        if "digest" in data and scene.is_other(picture):
            return "another picture"
        return ""

    return _fuzz(depth_files(arrays), count, first, use)


def main(arguments: list[str]) -> None:
    """Print figures and faults; exit with 1 if there is a fault."""
    folder = Path(arguments[0])
    folder.mkdir(parents=True, exist_ok=True)
    count = int(arguments[1]) if len(arguments) > 1 else 100
    faults = []
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for name, fuzz in (("depth", fuzz_depths), ("camera", fuzz_cameras)):
        start = time.perf_counter()
        tried, refused, found = fuzz(folder, count)
        spent = time.perf_counter() - start
        print(f"{tried} {name} files, {refused} refused, {len(found)} faults, {spent:.0f} s")
        faults += [f"{name} {fault}" for fault in found]
    used = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e6
    print(f"at most {used:.2f} GB")
    if used > _MEMORY:
        faults.append(f"{used:.2f} GB")
    print("\n".join(faults))
    sys.exit(bool(faults))


if __name__ == "__main__":
    main(sys.argv[1:])
