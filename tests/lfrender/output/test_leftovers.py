"""Files of an earlier run never stay beside those of a new one, as if they were one result."""

from __future__ import annotations

import os

import numpy as np
import pytest

import lfrender
from lfcal import OutputError
from lfrender.data.rendering import Rendering
from lfrender.output.picture import write_stack
from lfrender.output.posed_files import check_posed_folder, write_posed_views
from lfrender.output.raw_video import write_view_videos
from lfrender.output.views import check_grid, write_grid
from lfrender.rendering.viewpoints import grid_offsets, views_with_depth


def pictures(count):
    image = np.full((8, 10), 7, np.uint8)
    valid = np.ones((8, 10), bool)
    return [Rendering(image, np.eye(2, 3), valid, 1.0)] * count


def test_a_smaller_grid_of_views_is_refused_beside_a_larger_one(tmp_path):
    write_grid(tmp_path, pictures(9), 3, ".png")
    write_grid(tmp_path, pictures(9), 3, ".png")  # replaces all of them
    before = sorted(os.listdir(tmp_path))
    with pytest.raises(OutputError, match=r"holds row1_column3\.png of an earlier run, 5 files"):
        check_grid(tmp_path, ".png", grid=(2, 2))
    assert sorted(os.listdir(tmp_path)) == before
    with pytest.raises(OutputError, match="earlier run"):
        write_grid(tmp_path, pictures(4), 2, ".png")


def test_a_shorter_stack_is_refused_and_nothing_is_written(tmp_path):
    write_stack(tmp_path / "stack.png", pictures(5))
    (tmp_path / "stack_01.png").write_bytes(b"untouched")
    (tmp_path / "stack_notes.png").write_bytes(b"of the user")
    with pytest.raises(OutputError, match=r"holds stack_03\.png of an earlier run, 3 files"):
        write_stack(tmp_path / "stack.png", pictures(2))
    assert (tmp_path / "stack_01.png").read_bytes() == b"untouched"
    write_stack(tmp_path / "stack.png", pictures(5))


def test_fewer_raw_videos_of_views_are_refused(tmp_path):
    pytest.importorskip("av")
    write_view_videos(tmp_path, pictures(4))
    with pytest.raises(OutputError, match=r"holds v002-10x8\.yuv of an earlier run, 2 files"):
        write_view_videos(tmp_path, pictures(2))


@pytest.mark.parametrize("kind", ["colmap", "nerfstudio", "rvs"])
def test_fewer_posed_views_are_refused(tmp_path, kind):
    if kind == "rvs":
        pytest.importorskip("av")
    flat, camera, depth = lfrender.data.example()

    def write(side, kind):
        offsets = grid_offsets(side, side, 4.0)
        views = views_with_depth(flat, camera, depth, offsets=offsets, scale=4, still=-7.0)
        write_posed_views(tmp_path, kind, views, camera, depth, offsets, -7.0)

    write(2, kind)
    write(2, kind)
    with pytest.raises(OutputError, match="of an earlier run"):
        write(1, kind)
    if kind != "rvs":
        with pytest.raises(
            OutputError, match=r"images: holds view_002\.png of an earlier run, 2 files"
        ):
            check_posed_folder(tmp_path, kind, 2)
    if kind == "nerfstudio":
        with pytest.raises(OutputError, match=r"masks: holds view_000\.png of an earlier run"):
            write(2, "colmap")
