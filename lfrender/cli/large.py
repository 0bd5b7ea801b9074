"""The commands `analyze` and `render` on flats that are too large for memory, with the same options and figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import figures
from .inputs import CaptureInput, is_published
from .options import option_errors

if TYPE_CHECKING:
    from lfcal import Calibration, FlatSource

    from ..data.depth_map import DepthMap
    from ..output.resume import Checkpoint

__all__ = ["analyze_in_tiles", "render_in_tiles"]


def analyze_in_tiles(capture: CaptureInput, skip: bool, cluster: dict[str, Any]) -> tuple[DepthMap, Calibration]:
    """Calibrate, and analyse in tiles."""
    with capture.report.stage("read"):
        source = capture.open()
    with source:
        calibration = _find_camera(capture, source)
        with capture.report.stage("analyze"):
            return _analyze(capture, source, calibration, cluster, skip), calibration


def render_in_tiles(
    capture: CaptureInput,
    output: Path,
    cluster: dict[str, Any],
    *,
    patch_size: float | None,
    alpha: bool,
    **options: Any,
) -> None:
    """Calibrate, analyse and render in tiles; what is finished is kept until the picture is there."""
    from .. import render_large
    from ..data.depth_map import DepthMap
    from ..large.render import check_large_picture
    from ..output.resume import Checkpoint, fingerprint

    report = capture.report
    with report.stage("read"):
        source = capture.open()
    with source:
        check_large_picture(output, source.dtype, alpha, capture.files)
        checkpoint = Checkpoint(output)
        calibration = _find_camera(capture, source, checkpoint)
        depth = None
        if patch_size is None:
            with report.stage("analyze"):
                if capture.depth_file is not None:
                    raw = calibration.mosaic is not None and len(source.shape) == 2
                    depth = capture.read_depth(None if raw else source)
                else:
                    key = fingerprint(_identity(capture), calibration.to_dict(), capture.preset)
                    depth = checkpoint.reuse(
                        "depth.npz", key, DepthMap.load, lambda: _analyze(capture, source, calibration, cluster)
                    )
        settings = figures.rendering_settings(depth, patch_size, detail=options.get("detail"))
        with report.stage("render"), report.progress("tiles") as progress, option_errors():
            made = render_large(
                source, output, calibration, depth, patch_size=patch_size, alpha=alpha, settings=settings,
                progress=progress, **options, **cluster,
            )  # fmt: skip
    kept = f", {made.kept} of them kept from an earlier run" if made.kept else ""
    width, height = made.size
    found = {
        "picture": str(output), "size": list(made.size), "scale": made.scale, "valid": made.valid,
        "affine": made.affine, "tiles": made.tiles, "tiles_kept": made.kept,
    }  # fmt: skip
    report.finish(
        found | figures.capture_figures(calibration, depth),
        *figures.capture_sentences(capture, calibration, depth),
        f"{output}: {width} x {height} px in {made.tiles} tiles{kept}, in {report.took}.",
    )


def _find_camera(capture: CaptureInput, source: FlatSource, checkpoint: Checkpoint | None = None) -> Calibration:
    """The camera of the file, or calibrated on all pixels, unless that is in the checkpoint."""
    from lfcal import load

    from ..output.resume import file_identity, fingerprint

    with capture.report.stage("calibrate"):
        if capture.camera is not None and not is_published(capture.camera):
            return capture.find_camera(source)
        if checkpoint is None:
            return capture.find_camera(capture.read_pixels())
        key = fingerprint(_identity(capture), *map(file_identity, (capture.white, capture.camera)), capture.mosaic)
        return checkpoint.reuse("camera.json", key, load, lambda: capture.find_camera(capture.read_pixels()))


def _identity(capture: CaptureInput) -> list[Any]:
    """What changes if the pixels of the flat do."""
    from ..output.resume import file_identity

    return [*file_identity(capture.flat), capture.page, *file_identity(capture.dark)]


def _analyze(
    capture: CaptureInput, source: FlatSource, calibration: Calibration, cluster: dict[str, Any], skip: bool = True
) -> DepthMap:
    from .. import analyze_large

    preset = capture.preset or "balanced"
    with capture.report.progress("tiles") as progress:
        return analyze_large(source, calibration, preset, skip=skip, progress=progress, **cluster)
