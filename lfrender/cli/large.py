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
                    files = [file_identity(capture.flat), file_identity(capture.dark)]
                    settings = [capture.page, capture.chosen_preset]
                    key = fingerprint(files, settings, calibration.to_dict())
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
        about = figures.rendering_settings(depth, given.patch_size, given.detail)
        chosen = LargeOptions(settings=about, tile=given.tile, **options)
        with report.stage("render"), report.progress("tiles") as step, option_errors():
            made = render_large(
                source, output, calibration, depth, chosen, progress=step, **cluster
            )
    width, height = made.size
    tiles = f"{made.tiles} tiles"
    if made.kept:
        tiles += f", {made.kept} of them kept from an earlier run"
    found = {name: getattr(made, name) for name in ("size", "scale", "valid", "affine", "tiles")}
    found |= {"picture": str(output), "tiles_kept": made.kept}
    report.finish(
        found | figures.capture_figures(calibration, depth),
        *capture.sentences(calibration, depth),
        f"{output}: {width} x {height} px in {tiles}, in {report.took}.",
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

    preset = capture.chosen_preset
    with capture.report.progress("tiles") as step:
        return analyze_large(source, calibration, preset, skip=skip, progress=step, **cluster)
