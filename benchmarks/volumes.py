"""Volumes against the truth of simulated microscopes: `python -m benchmarks.volumes [SHARED]`.

For 20 ray-traced beads, the command prints the errors of their places and the width of the response
by depth. For ray-traced shells and beads on three microscopes, it prints correlation with the truth
and PSNR (with one gain), also for the focal stack of the same flat. `--waves` adds shells by scalar
waves (minutes). With the folder SHARED, it prints processor seconds and memory for the captures of
microscopes in it. Nothing was chosen on these specimens.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender
from data_synth.microscopy import (
    Microscope,
    MicroscopeCapture,
    Specimen,
    propagate_flat,
    trace_flat,
)

Array = NDArray[np.float64]

#: Optics of the captures as their owners state them, and a depth range [um], or slopes k where they
#: are not known.
CAPTURES: dict[str, tuple[dict[str, float], tuple[float, float]]] = {
    "GUV": (
        {
            "na": 1.2,
            "magnification": 60,
            "medium_index": 1.35,
            "microlens_focal_length": 2500,
            "pixel_size": 6.5,
            "wavelength": 593,
        },
        (-15.0, 15.0),
    ),
    "Beads": ({}, (-18.0, 18.0)),
    "AntLeg": (
        {
            "na": 0.5,
            "magnification": 20,
            "medium_index": 1.33,
            "microlens_focal_length": 2433,
            "pixel_size": 4.55,
        },
        (-200.0, 160.0),
    ),
}
_MICROSCOPES = {
    "60x, NA 1.2, D = 15.4 px": {"rotation": 0.5},
    "60x, NA 1.2, D = 14.2 px, turned by 4 degrees": {"pitch": 14.2, "rotation": 4.0},
    "20x, NA 0.5, D = 17.3 px": {
        "pitch": 17.3,
        "na": 0.5,
        "magnification": 20.0,
        "medium_index": 1.33,
        "microlens_focal_length": 2200.0,
    },
}


def axes(volume: lfrender.Volume, microscope: Microscope) -> tuple[Array, Array, Array]:
    """Places x, y and z [um] of the voxels, x and y from the middle of the flat."""
    found = []
    for axis, size in ((2, microscope.size[0]), (1, microscope.size[1])):
        count = volume.data.shape[axis]
        middle = (size - 1) / 2 * microscope.object_pixel
        found.append(
            volume.origin[axis] + volume.spacing[axis] * np.arange(count, dtype=np.float64) - middle
        )
    return found[0], found[1], volume.depths


def score(data: NDArray[Any], truth: NDArray[Any]) -> tuple[float, float]:
    """Correlation with the truth, and PSNR [dB] with one gain."""
    one = data.ravel().astype(float)
    other = truth.ravel().astype(float)
    gain = (one @ other) / (one @ one)
    error = np.mean((gain * one - other) ** 2)
    return float(np.corrcoef(one, other)[0, 1]), float(10 * np.log10(other.max() ** 2 / error))


def locate(volume: lfrender.Volume, microscope: Microscope, place: Array) -> tuple[Array, float]:
    """Centroid [um] around the brightest voxel near a place, and width in z [um]."""
    x, y, z = axes(volume, microscope)
    near = [
        np.abs(axis - at) <= reach
        for axis, at, reach in zip((z, y, x), place[::-1], (4.0, 1.7, 1.7), strict=True)
    ]
    part = volume.data[np.ix_(*near)]
    zs, ys, xs = (axis[chosen] for axis, chosen in zip((z, y, x), near, strict=True))
    lit = np.where(part >= 0.5 * part.max(), part, 0).astype(float)
    total = lit.sum()
    centre = [
        (lit.sum((0, 1)) * xs).sum() / total,
        (lit.sum((0, 2)) * ys).sum() / total,
        (lit.sum((1, 2)) * zs).sum() / total,
    ]
    profile = part.max((1, 2))
    width = float((profile >= 0.5 * profile.max()).sum()) * volume.spacing[0]
    return np.array(centre), width


def bead_places(count: int, seed: int) -> Array:
    """Places (n, 3) [um] of beads on a grid, moved at random, at depths from -9 to 9 um off the
    native plane."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(count)))
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)[:count]
    across = (cells - (side - 1) / 2) * 6.0 + rng.uniform(-1, 1, (count, 2))
    depth = rng.permutation(np.linspace(2.0, 9.0, count)) * rng.choice([-1, 1], count)
    return np.column_stack([across, depth])


def reconstruct(
    capture: MicroscopeCapture, depth: float, planes: int, **options: Any
) -> lfrender.Volume:
    """Volume of a capture, reconstructed with the true optics."""
    optics = lfrender.Microscope(**capture.microscope.optics(), **options)
    return lfrender.reconstruct_volume(
        capture.flat, capture.calibration, optics, depth_range=(-depth, depth), planes=planes
    )


def focal_stack(capture: MicroscopeCapture, volume: lfrender.Volume) -> NDArray[np.float32]:
    """Focal stack on the same voxels: mean over the pixels that see a voxel."""
    from lfrender.volume.grid import VoxelGrid
    from lfrender.volume.pixels import choose_pixels

    microscope = capture.microscope
    lattice = capture.calibration.lattice
    scale = lfrender.Microscope(**microscope.optics()).scale(lattice.radius, lattice.pitch)
    pixels = choose_pixels(
        capture.flat.astype(np.float32), capture.calibration, scale.flat_radius, scale.pupil_radius
    )
    voxels = round(volume.pitch / volume.spacing[1])
    grid = VoxelGrid.over(lattice, volume.slopes, voxels, pixels.reach)
    projector = grid.projector(pixels, lattice, scale)
    total = projector.adjoint(pixels.values)
    light = projector.adjoint(pixels.light)
    return grid.crop(total / np.maximum(light, 1e-3 * light.max()))


def _beads(seed: int) -> list[tuple[float, float, float, float]]:
    microscope = Microscope(lenses=(25, 25), rotation=0.5)
    places = bead_places(20, seed)
    capture = trace_flat(
        Specimen.beads(places, 0.4), microscope, samples=192, seed=seed, electrons=3000
    )
    volume = reconstruct(capture, 11.0, 45)
    rows = []
    for place in places:
        found, width = locate(volume, microscope, place)
        aside = float(np.hypot(*(found - place)[:2])) / volume.pitch
        rows.append((float(place[2]), aside, float(found[2] - place[2]) / volume.spacing[0], width))
    return sorted(rows)


def _print_score(
    name: str, capture: MicroscopeCapture, depth: float, planes: int, **options: Any
) -> None:
    start = time.process_time()
    volume = reconstruct(capture, depth, planes, **options)
    seconds = time.process_time() - start
    truth = capture.specimen.volume(*axes(volume, capture.microscope))
    agreement, psnr = score(volume.data, truth)
    stack, stack_psnr = score(focal_stack(capture, volume), truth)
    fit = volume.fit
    print(
        f"{name:48s} {agreement:.3f} {psnr:5.1f} dB   focal stack {stack:.3f} {stack_psnr:5.1f} dB "
        f"  residual "
        f"{fit.residual:.3f}, noise {fit.noise:.3f}, {fit.steps} steps: {fit.reason}, "
        f"{seconds:.1f} s"
    )


def _shells(scale: float) -> Specimen:
    """Two shells and three beads; `scale` 1 for objectives of 60x."""
    beads = Specimen.beads(
        scale * np.array([[-10.0, 8.0, 5.0], [9.0, -11.0, -6.5], [-9.0, -9.0, 3.0]]), 0.7 * scale
    )
    large = Specimen.shell(8.0 * scale, 1.4 * scale, scale * np.array([-0.5, 0.8, -1.2]))
    small = Specimen.shell(3.5 * scale, 1.2 * scale, scale * np.array([9.0, 8.5, 4.0]))
    return large + small + beads


def _plot(rows: list[tuple[float, float, float, float]], path: Path) -> None:
    import matplotlib.pyplot as plt

    depth, aside, along, width = np.array(rows).T
    figure, panels = plt.subplots(1, 2, figsize=(8, 3), layout="tight")
    panels[0].plot(depth, aside, "o", label="sideways [pitches]")
    panels[0].plot(depth, np.abs(along), "x", label="in depth [planes]")
    panels[0].set(xlabel="depth of the bead [µm]", ylabel="error")
    panels[0].legend()
    panels[1].plot(depth, width, "o")
    panels[1].set(xlabel="depth of the bead [µm]", ylabel="width in depth [µm]", ylim=(0, None))
    figure.savefig(path, dpi=110)


def _captures(folder: Path, pictures: Path | None) -> None:
    for name in CAPTURES:
        measure(folder, name, pictures)


def measure(folder: Path, name: str, pictures: Path | None = None) -> dict[str, float]:
    """Print what the volume of a capture takes, and return it; empty where it is missing."""
    optics, depth_range = CAPTURES[name]
    flat, white, dark = (
        next(folder.glob(f"{name}{kind}.[tp]*"), None) for kind in ("", ".white", ".dark")
    )
    if flat is None or white is None:
        return {}
    pixels = lfcal.read_flat(flat)
    light = lfcal.read_flat(white)
    if dark is not None:
        frame = lfcal.read_flat(dark)
        pixels = lfcal.subtract_dark(pixels, frame)
        light = lfcal.subtract_dark(light, frame)
    camera = lfcal.calibrate(light, kind="white")
    start = time.process_time()
    wall = time.perf_counter()
    volume = lfrender.reconstruct_volume(
        pixels, camera, lfrender.Microscope(**optics), depth_range=depth_range
    )
    seconds = time.process_time() - start
    passed = time.perf_counter() - wall
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    fit = volume.fit
    print(
        f"{name:7s} {volume}: {seconds:.0f} processor seconds ({passed:.0f} s), peak "
        f"{peak:.0f} MB, residual "
        f"{fit.residual:.3f}, noise {fit.noise:.3f}, {fit.steps} steps: {fit.reason}",
        flush=True,
    )
    if pictures:
        volume.plot().savefig(pictures / f"{name}.jpg", dpi=110)
    return {"cpu": seconds, "steps": fit.steps, "residual": fit.residual, "noise": fit.noise}


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shared", type=Path, nargs="?", default=Path("../shared"))
    parser.add_argument("--waves", action="store_true", help="shells by scalar waves too")
    parser.add_argument(
        "--pictures", type=Path, help="folder for a plot of the beads, and the volumes of captures"
    )
    given = parser.parse_args()
    rows = _beads(seed=11)
    print(
        "beads: depth [um], error sideways [pitches] and in depth [planes of 0.5 um], width in "
        "depth [um]"
    )
    for row in rows:
        print("{:7.2f} {:7.3f} {:7.2f} {:7.2f}".format(*row))
    aside = np.array(rows)[:, 1]
    along = np.abs(np.array(rows)[:, 2])
    print(f"largest: {aside.max():.3f} pitches, {along.max():.2f} planes")
    if given.pictures:
        _plot(rows, given.pictures / "beads.png")
    for number, (name, options) in enumerate(_MICROSCOPES.items()):
        microscope = Microscope(lenses=(21, 21), **options)
        scale = 1.0 if microscope.magnification == 60 else 4.0
        depth = (10.0 if scale == 1 else 25.0) * scale
        capture = trace_flat(_shells(scale), microscope, samples=192, seed=number, electrons=3000)
        _print_score(f"rays, {name}", capture, depth, 31)
    if given.waves:
        microscope = Microscope(lenses=(15, 15), rotation=1.0)
        specimen = Specimen.shell(4.2, 1.1, (-0.4, 0.5, -0.9)) + Specimen.shell(
            2.2, 1.0, (5.0, -4.5, 3.5)
        )
        capture = propagate_flat(specimen, microscope, spacing=0.5, seed=3, electrons=3000)
        _print_score("waves, 60x, NA 1.2, D = 15.4 px", capture, 9.0, 31, wavelength=593)
    _captures(given.shared / "captures", given.pictures)


if __name__ == "__main__":
    main()
