"""The commands `analyze` and `render` on flats that are too large for memory."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from . import figures
from .inputs import CaptureInput, is_published
from .options import option_errors

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lfcal import Calibration, FlatSource

    from ..data.depth_map import DepthMap

__all__ = ["analyze_in_tiles", "render_in_tiles"]


def analyze_in_tiles(
    capture: CaptureInput, skip: bool, cluster: dict[str, Any]
) -> tuple[DepthMap, Calibration]:
    """Calibrate, and analyse in tiles."""
    with _open(capture) as source:
        calibration = _calibrate(capture, source)
        with capture.report.stage("analyze"):
            return _analyze(capture, source, calibration, cluster, skip), calibration


def render_in_tiles(
    capture: CaptureInput, given: Any, cluster: dict[str, Any], **options: Any
) -> None:
    """Calibrate, analyse and render in tiles; what is finished is kept until the end."""
    from .. import render_large
    from ..data.depth_map import DepthMap
    from ..large.render import LargeOptions, check_large_picture
    from ..output.resume import Checkpoint, file_identity, fingerprint

    report = capture.report
    output = given.output
    depth = None
    with _open(capture) as source:
        check_large_picture(output, source.dtype, given.alpha, capture.files)
        calibration = _calibrate(capture, source)
        if given.patch_size is None:
            with report.stage("analyze"):
                if capture.depth_file is not None:
                    raw = calibration.mosaic is not None and len(source.shape) == 2
                    depth = capture.read_depth(None if raw else source)
                else:
                    pixels = [
                        *file_identity(capture.flat),
                        capture.page,
                        *file_identity(capture.dark),
                    ]
                    key = fingerprint(pixels, calibration.to_dict(), capture.preset)
                    checkpoint = Checkpoint(output)
                    file = checkpoint.folder / "depth.npz"
                    if not (checkpoint.find("depth", key) and file.exists()):
                        found_depth = _analyze(capture, source, calibration, cluster)
                        checkpoint.open()
                        found_depth.save(file)
                        checkpoint.keep("depth", key)
                    # Always from the file: later results do not depend on whether a run was
                    # interrupted.
                    depth = DepthMap.load(file)
        settings = figures.rendering_settings(depth, given.patch_size, given.detail)
        with report.stage("render"), report.progress("tiles") as progress, option_errors():
            chosen = LargeOptions(settings=settings, tile=given.tile, **options)
            made = render_large(
                source, output, calibration, depth, chosen, progress=progress, **cluster
            )
    kept = f", {made.kept} of them kept from an earlier run" if made.kept else ""
    width, height = made.size
    found = {
        "picture": str(output),
        "size": made.size,
        "scale": made.scale,
        "valid": made.valid,
        "affine": made.affine,
        "tiles": made.tiles,
        "tiles_kept": made.kept,
    }
    report.finish(
        found | figures.capture_figures(calibration, depth),
        *capture.sentences(calibration, depth),
        f"{output}: {width} x {height} px in {made.tiles} tiles{kept}, in {report.took}.",
    )


@contextmanager
def _open(capture: CaptureInput) -> Iterator[FlatSource]:
    with capture.report.stage("read"):
        opened = capture.open()
    with opened as source:
        yield source


def _calibrate(capture: CaptureInput, source: FlatSource) -> Calibration:
    """The camera of the file, or calibrated on all pixels."""
    with capture.report.stage("calibrate"):
        known = capture.camera is not None and not is_published(capture.camera)
        return capture.find_camera(source if known else capture.read_pixels())


def _analyze(
    capture: CaptureInput,
    source: FlatSource,
    calibration: Calibration,
    cluster: dict[str, Any],
    skip: bool = True,
) -> DepthMap:
    from .. import analyze_large

    with capture.report.progress("tiles") as progress:
        return analyze_large(
            source,
            calibration,
            capture.preset or "balanced",
            skip=skip,
            progress=progress,
            **cluster,
        )
