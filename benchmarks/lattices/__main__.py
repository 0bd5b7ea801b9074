"""`python -m benchmarks.lattices cameras|rays|no-flats|fit FIRST LAST`, or `forms|crops FLAT...`.

- `cameras`, `rays`: flats of random cameras of all kinds (by formula, or ray-traced): right, wrong
  and refused lattices, and how often results of each stated confidence are right.
- `no-flats`: pictures that are no flats: refused, doubted and sure ones.
- `forms`: each flat turned, mirrored, darker, noisy, with gamma, compressed; `crops`: its parts.
- `fit`: the weights of `lfcal.camera.evidence`, fitted to even seeds and tried on odd ones.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import lfcal

from ..camera_kinds import draw_kind
from ..no_flats import draw_no_flat
from .fit import collect_examples, fit_weights, whole_centres
from .judgement import RIGHT, compare_with_centres
from .random_cameras import draw_camera

_Centres = NDArray[np.float64]
_Item = tuple[str, NDArray[Any], _Centres | None]
_SURE = 0.8


def _cameras(first: int, last: int) -> Iterator[_Item]:
    for seed in range(first, last):
        drawn = draw_camera(seed)
        yield f"{seed} {drawn.name}", drawn.image, drawn.centres


def _rays(first: int, last: int) -> Iterator[_Item]:
    for seed in range(first, last):
        name, capture = draw_kind(seed)
        yield f"{seed} {name}", capture.flat, whole_centres(capture.truth.calibration.lattice)


def _no_flats(first: int, last: int) -> Iterator[_Item]:
    for seed in range(first, last):
        name, picture = draw_no_flat(seed)
        yield f"{seed} {name}", picture, None


#: Sets of random flats; each is called with the first seed and the one after the last.
SEEDS = {"cameras": _cameras, "rays": _rays, "no-flats": _no_flats}
_FORMS: dict[str, Callable[[NDArray[Any]], NDArray[Any]]] = {
    "turned": lambda flat: np.ascontiguousarray(np.rot90(flat)),
    "upside down": lambda flat: np.ascontiguousarray(flat[::-1, ::-1]),
    "mirrored": lambda flat: np.ascontiguousarray(flat[:, ::-1]),
    "half as bright": lambda flat: flat // 2,
    "gamma 2.2": lambda flat: np.rint(
        65535 * (flat / float(np.iinfo(flat.dtype).max)) ** 2.2
    ).astype(np.uint16),
    "JPEG 60": lambda flat: _compress(flat),
}


def _compress(flat: NDArray[Any]) -> NDArray[Any]:
    eight = flat if flat.dtype == np.uint8 else (flat // 257).astype(np.uint8)
    coded = cv2.imencode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, 60])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_UNCHANGED))


def _forms(paths: list[str]) -> Iterator[_Item]:
    """Other forms of flats, with the centres that are found on the flat as it is, moved with the
    pixels.
    """
    for path in paths:
        flat = lfcal.read_flat(path)
        centres = whole_centres(lfcal.calibrate(flat).lattice)
        height, width = flat.shape[:2]
        x, y = centres.T
        moved = {
            "turned": np.column_stack([y, width - 1 - x]),
            "upside down": np.column_stack([width - 1 - x, height - 1 - y]),
            "mirrored": np.column_stack([width - 1 - x, y]),
        }
        for name, form in _FORMS.items():
            if flat.dtype.kind == "u":
                yield f"{path} {name}", form(flat), moved.get(name, centres)


def _crops(paths: list[str]) -> Iterator[_Item]:
    """Crops of about 14 to 30 lenses each way, with the centres found on the whole flat."""
    rng = np.random.default_rng(0)
    for path in paths:
        flat = lfcal.read_flat(path)
        lattice = lfcal.calibrate(flat).lattice
        for _ in range(5):
            side = np.minimum(rng.uniform(14, 30, 2) * lattice.pitch, flat.shape[1::-1]).astype(int)
            left, top = (
                int(rng.integers(0, room + 1)) for room in np.array(flat.shape[1::-1]) - side
            )
            part = np.ascontiguousarray(flat[top : top + side[1], left : left + side[0]])
            centres = whole_centres(lattice) - (left, top)
            margin = lattice.pitch / 2
            inside = (centres >= margin).all(1) & (centres <= side - 1 - margin).all(1)
            yield f"{path} {side[0]} x {side[1]} at {left}, {top}", part, centres[inside]


def judge(items: Iterator[_Item]) -> dict[str, int]:
    """Calibrate each item; print every one that is not right and sure, and the counts.

    Returns the numbers of right, wrong, refused lattices, and of wrong ones that are stated as
    sure.
    """
    stated: list[tuple[float, bool]] = []
    refused = 0
    for name, flat, centres in items:
        try:
            camera = lfcal.calibrate(flat)
        except lfcal.CalibrationError as error:
            refused += 1
            if centres is not None:
                print(f"refused  {name}: {error}", flush=True)
            continue
        right = False
        text = "no flat"
        if centres is not None:
            found = compare_with_centres(camera.lattice, centres)
            right = found.is_right
            text = f"{found.distance:.3f} pitches off, {found.cells} cells a lens"
        stated.append((camera.confidence, right))
        if not right or camera.confidence < _SURE:
            print(
                f"{'right' if right else 'WRONG'} at {camera.confidence:.2f} {name}: {text}",
                flush=True,
            )
    sure = [right for confidence, right in stated if confidence >= _SURE]
    rights = sum(right for _, right in stated)
    print(
        f"{len(stated) + refused} flats: {rights} right (to {RIGHT} pitches), "
        f"{len(stated) - rights} wrong, {refused} "
        f"refused; of {len(sure)} sure ones {sum(sure)} right"
    )
    for low in np.arange(0.5, 1.0, 0.1):
        some = [right for confidence, right in stated if low <= confidence < low + 0.1]
        if some:
            print(f"  confidence {low:.1f} to {low + 0.1:.1f}: {sum(some)} of {len(some)} right")
    wrong = len(stated) - rights
    return {"right": rights, "wrong": wrong, "refused": refused, "sure": len(sure) - sum(sure)}


def _fit(first: int, last: int) -> None:
    examples = list(collect_examples(first, last))
    constant, weights = fit_weights(examples)
    print(f"constant {constant:.2f}")
    for name, weight in weights.items():
        print(f"{name} {weight:.2f}")


def main(arguments: list[str]) -> None:
    """Run the command that the first argument names."""
    command, *rest = arguments
    if command == "fit":
        _fit(int(rest[0]), int(rest[1]))
        return
    flats = {"forms": _forms, "crops": _crops}
    if command in flats:
        judge(flats[command](rest))
    else:
        judge(SEEDS[command](int(rest[0]), int(rest[1])))


if __name__ == "__main__":
    main(sys.argv[1:])
