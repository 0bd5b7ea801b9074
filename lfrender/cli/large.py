"""The commands on flats that are too large for memory: the same options, and the same figures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from lfcal import LightFieldError

from ..large.size import is_large
from .figures import camera_figures, depth_figures, settings_of
from .inputs import camera_of, is_published

if TYPE_CHECKING:
    from lfcal import Calibration, FlatSource

    from ..data.depth_map import DepthMap
    from ..output.resume import Checkpoint

__all__ = ["Asked", "Cluster", "analyze", "is_large", "render", "wanted"]


@dataclass(frozen=True)
class Asked:
    """What `lfrender render` was asked for."""

    flat: Path
    output: Path
    camera: Path | None
    white: Path | None
    depth_file: Path | None
    patch_size: float | None
    scale: float | None
    blend: bool | None
    mosaic: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None
    alpha: bool
    compress: bool
    tile: int | None
    preset: str
    on: Cluster


@dataclass(frozen=True)
class Cluster:
    """Where tiles are to be worked on: on so many processes, on the workers of a scheduler, or here."""

    workers: int | None = None
    scheduler: str | None = None

    def __bool__(self) -> bool:
        return self.workers is not None or self.scheduler is not None

    @contextmanager
    def options(self) -> Iterator[dict[str, Any]]:
        """What `analyze_large` and `render_large` are to be told."""
        if not self:
            yield {}
            return
        from ..sequence.cluster import connect

        with connect(self.workers, self.scheduler) as client:
            yield {"client": client, "threads": 1 if self.workers else None}


def wanted(flat: Path, output: Path, tile: int | None, on: Cluster) -> bool:
    """Whether a flat is to be worked on in tiles."""
    if on or tile is not None or output.suffix.lower() == ".zarr":
        return True
    return is_large(flat)


def render(report: Any, asked: Asked) -> None:
    """Calibrate, analyse and render in tiles, keeping what is finished."""
    from .. import render_large
    from ..large.render import check_large_picture
    from ..output.resume import Checkpoint

    with report.stage("read"):
        from lfcal import open_flat

        source = open_flat(asked.flat)
        inputs = [asked.flat, asked.camera, asked.white, asked.depth_file]
        check_large_picture(asked.output, source.dtype, asked.alpha, inputs)
        unfinished = Checkpoint(asked.output)
    with source, asked.on.options() as workers:
        with report.stage("calibrate"):
            calibration = _camera(report, asked, source, unfinished)
        depth = None
        if asked.patch_size is None:
            with report.stage("analyze"):
                depth = _depth(report, asked, source, calibration, unfinished, workers)
        report.announce_compilation("lfrender")
        with report.stage("render"), report.counted_progress("tiles") as progress:
            try:
                made = render_large(
                    source, asked.output, calibration, depth, patch_size=asked.patch_size, scale=asked.scale,
                    blend=asked.blend, tile=asked.tile, alpha=asked.alpha, compress=asked.compress,
                    settings=settings_of(depth, asked.patch_size), progress=progress, **workers,
                )  # fmt: skip
            except LightFieldError:
                raise
            except ValueError as error:
                raise click.UsageError(str(error)) from error
    figures = {
        "picture": str(asked.output), "size": list(made.size), "scale": made.scale, "valid": made.valid,
        "affine": made.affine, "tiles": made.tiles, "tiles_kept": made.kept, **camera_figures(calibration, depth),
        **(depth_figures(depth) if depth else {}),
    }  # fmt: skip
    report.finish(figures)


def analyze(
    report: Any, flat: Path, camera: Path | None, white: Path | None, output: Path, preset: str, skip: bool, on: Cluster
) -> tuple[DepthMap, Calibration]:
    """Analyse in tiles, and save the depth."""
    from .. import analyze_large

    with report.stage("read"):
        from lfcal import open_flat, read_flat

        source = open_flat(flat)
    with source, on.options() as workers:
        with report.stage("calibrate"):
            # Our own camera files need the size of the flat only.
            own = camera is not None and not is_published(camera)
            pixels: Any = source if own else read_flat(flat)
            calibration = camera_of(report, flat, pixels, camera, white, None)
            del pixels
        report.announce_compilation("lfrender")
        with report.stage("analyze"), report.counted_progress("tiles") as progress:
            depth = analyze_large(source, calibration, preset, skip=skip, progress=progress, **workers)
        depth.save(output)
    return depth, calibration


def _camera(report: Any, asked: Asked, source: FlatSource, unfinished: Checkpoint) -> Calibration:
    """The camera of a file, or calibrated, which an earlier run may have done."""
    from lfcal import load, read_flat

    from ..output.resume import file_identity, fingerprint

    if asked.camera is not None and not is_published(asked.camera):
        shape: Any = source
        return camera_of(report, asked.flat, shape, asked.camera, None, asked.mosaic)
    key = fingerprint(file_identity(asked.flat), file_identity(asked.white), file_identity(asked.camera), asked.mosaic)
    file = unfinished.folder / "camera.json"
    if unfinished.find("camera", key) and file.exists():
        return load(file)
    pixels = read_flat(asked.flat)
    calibration = camera_of(report, asked.flat, pixels, asked.camera, asked.white, asked.mosaic)
    unfinished.open()
    calibration.save(file)
    unfinished.keep("camera", key)
    # As it will be read again, so that a picture does not depend on whether a run was killed.
    return load(file)


def _depth(
    report: Any,
    asked: Asked,
    source: FlatSource,
    calibration: Calibration,
    unfinished: Checkpoint,
    workers: dict[str, Any],
) -> DepthMap:
    """The depth of a file, or analysed, which an earlier run may have done."""
    from .. import analyze_large
    from ..data.depth_map import DepthMap
    from ..output.resume import file_identity, fingerprint

    if asked.depth_file is not None:
        return DepthMap.load(asked.depth_file)
    key = fingerprint(file_identity(asked.flat), calibration.to_dict(), asked.preset)
    file = unfinished.folder / "depth.npz"
    if unfinished.find("depth", key) and file.exists():
        return DepthMap.load(file)
    report.announce_compilation("lfrender")
    with report.counted_progress("tiles") as progress:
        depth = analyze_large(source, calibration, asked.preset, progress=progress, **workers)
    unfinished.open()
    depth.save(file)
    unfinished.keep("depth", key)
    return depth
