"""Views of every frame as converters for lenslet video write them: names, order, frames at their
place, continued.
"""

from __future__ import annotations

from itertools import islice

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import lfcal
import lfrender
from lfrender.cli.main import main
from lfrender.output.raw_video import frame_bytes, yuv_frame
from lfrender.output.views import resize_view, scale_for_size
from lfrender.rendering.viewpoints import grid_offsets, still_depth
from lfrender.sequence.run_folder import load_camera
from lfrender.sequence.view_grid import ViewGrid

av = pytest.importorskip("av", reason="raw video is written by PyAV (lfrender[video])")

GRID = ViewGrid(2, 2, 0.5)
SIZE = (160, 120)


@pytest.fixture(scope="module")
def frames(house, tmp_path_factory):
    """Four frames, the second of which cannot be read."""
    folder = tmp_path_factory.mktemp("frames")
    for k in range(4):
        flat = np.rint(house.flat * (1 - 0.1 * k)).astype(np.uint8)
        cv2.imwrite(str(folder / f"f{k}.png"), flat[..., ::-1])
    damaged = folder / "f1.png"
    damaged.write_bytes(damaged.read_bytes()[:3000])
    return lfrender.open_frames([folder])


@pytest.fixture(scope="module")
def raw_views(frames, house, tmp_path_factory):
    folder = tmp_path_factory.mktemp("out") / "views"
    camera = house.truth.calibration
    results = list(
        lfrender.render_frames(
            frames, folder, camera, preset="fast", suffix=".yuv", views=GRID, size=SIZE
        )
    )
    assert [r.outcome for r in results] == ["rendered", "failed", "rendered", "rendered"]
    return folder


def test_each_view_is_a_file_of_all_frames_in_ten_bits_named_as_tlct_does(raw_views):
    names = sorted(p.name for p in raw_views.iterdir() if p.is_file())
    assert names == [f"v{k:03d}-160x120.yuv" for k in range(4)]
    for name in names:
        assert (
            raw_views / name
        ).stat().st_size == 4 * 160 * 120 * 3  # 1.5 samples of 2 bytes per pixel
        assert lfcal.count_pages(raw_views / name) == 4


def test_views_follow_row_by_row_and_failed_frames_show_the_one_before(raw_views, frames, house):
    camera = house.truth.calibration
    flat = next(iter(frames)).read()
    depth = lfrender.analyze(flat, camera, "fast")
    scale = scale_for_size(camera, SIZE)
    drawn = [
        resize_view(picture, SIZE)
        for picture in GRID.draw(flat, camera, depth, scale, still_depth(depth))
    ]
    for number, picture in enumerate(drawn):
        data = (raw_views / f"v{number:03d}-160x120.yuv").read_bytes()
        size = 160 * 120 * 3
        assert data[:size] == frame_bytes(yuv_frame(picture.image, "yuv420p10"))
        assert data[size : 2 * size] == data[:size]
        assert data[2 * size : 3 * size] != data[:size]
    offsets = grid_offsets(2, 2, 1.0)
    assert offsets[0] < offsets[1] and offsets[0][1] < offsets[2][1]


def test_interrupted_run_is_continued_to_the_same_bits(raw_views, frames, house, tmp_path):
    camera = house.truth.calibration
    folder = tmp_path / "views"
    options = {"preset": "fast", "suffix": ".yuv", "views": GRID, "size": SIZE}
    started = lfrender.render_frames(frames, folder, camera, **options)
    list(islice(started, 1))
    started.close()
    assert not list(folder.glob("*.yuv"))
    outcomes = [r.outcome for r in lfrender.render_frames(frames, folder, camera, **options)]
    assert outcomes[0] == "kept"
    for path in sorted(raw_views.glob("*.yuv")):
        assert (folder / path.name).read_bytes() == path.read_bytes()
    with pytest.raises(lfcal.OutputError, match="another camera"):
        list(
            lfrender.render_frames(
                frames,
                folder,
                camera,
                preset="fast",
                suffix=".yuv",
                views=ViewGrid(3, 3),
                size=SIZE,
            )
        )


def test_pictures_of_views_are_in_a_folder_for_each_frame(frames, house, tmp_path):
    camera = house.truth.calibration
    one = lfrender.open_frames(frames.files[:1])
    (result,) = lfrender.render_frames(
        one, tmp_path / "v", camera, preset="fast", suffix=".png", views=GRID, size=SIZE
    )
    assert sorted(p.name for p in result.path.iterdir()) == [
        f"image_{k:03d}.png" for k in range(1, 5)
    ]
    assert lfcal.read_flat(result.path / "image_001.png").shape == (120, 160, 3)


def test_colours_of_raw_video_are_those_of_the_picture(tmp_path):
    y, x = np.mgrid[:40, :60]
    smooth = np.stack([x * 3 + 40, y * 4 + 30, 200 - x * 2], -1).astype(np.uint8)
    for name, limit in (("yuv420p", 4.0), ("yuv444p10", 1.0), ("yuv422p12", 2.0)):
        path = tmp_path / f"a_60x40_{name}.yuv"
        path.write_bytes(frame_bytes(yuv_frame(smooth, name)))
        again = lfcal.read_flat(path)
        again = again / 256 if again.dtype == np.uint16 else again.astype(float)
        assert np.abs(again - smooth)[2:-2, 2:-2].max() <= limit, name


def test_command_renders_raw_video_into_views_and_a_film(house, house_files, tmp_path):
    flat = lfcal.read_flat(house_files / "flat.png")
    height, width = flat.shape[:2]
    source = tmp_path / "shot.yuv"
    source.write_bytes(frame_bytes(yuv_frame(flat, "yuv444p10")) * 2)
    words = [
        "batch",
        str(source),
        "--pixel-format",
        "yuv444p10",
        "-c",
        str(house_files / "camera.json"),
    ]
    words += ["--preset", "fast", "--json"]
    done = CliRunner().invoke(
        main,
        [
            *words,
            "-o",
            str(tmp_path / "v"),
            "--views",
            "1x2",
            "--format",
            "yuv",
            "--resize",
            "200x150",
        ],
    )
    assert done.exit_code == 0, done.output
    assert sorted(p.name for p in (tmp_path / "v").glob("*.yuv")) == [
        "v000-200x150.yuv",
        "v001-200x150.yuv",
    ]
    # Its 10 bits, read as 16, are encoded for display, though 16 bits of a camera are taken to be
    # linear.
    assert load_camera(tmp_path / "v").encoded
    done = CliRunner().invoke(
        main, [*words, "-o", str(tmp_path / "sharp.yuv"), "--size", f"{width}x{height}"]
    )
    assert done.exit_code == 0, done.output
    assert (tmp_path / "sharp.yuv").stat().st_size % 6 == 0
    refused = CliRunner().invoke(main, [*words, "-o", str(tmp_path / "w"), "--format", "yuv"])
    assert refused.exit_code == 2 and "--views" in refused.stderr
