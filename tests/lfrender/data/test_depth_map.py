from dataclasses import replace

import numpy as np
import pytest

from lfrender import DepthMap
from lfrender.data.depth_file import DepthFileError
from lfrender.data.depth_map import default_scale
from lfrender.data.rendering import PictureGrid
from lfrender.data.surface import Surface


@pytest.fixture
def depth():
    s = np.array([4.0, -5.0, np.nan], np.float32)
    grid = np.linspace(-5, 4, 12, dtype=np.float32).reshape(3, 4)
    surface = Surface(grid, (-0.5, -0.5), 2.5)
    return DepthMap(
        s,
        np.array([0.1, 0.2, np.inf]),
        np.array([1, 0.9, 0]),
        np.nan_to_num(s),
        surface,
        20.0,
        (40, 30),
    )


def test_mode_and_magnification_follow_from_the_signed_patch_size(depth):
    assert depth.mode.tolist() == [1, -1, 0]
    assert depth.mode.dtype == np.int8
    np.testing.assert_allclose(depth.magnification, [5, 4, np.nan])
    assert depth.filled.tolist() == [False, False, True]


def test_save_and_load_give_the_same_map(depth, tmp_path):
    depth.save(tmp_path / "d.npz")
    again = DepthMap.load(tmp_path / "d.npz")
    for name in ("patch_size", "standard_error", "confidence", "filled_patch_size", "mode"):
        np.testing.assert_array_equal(getattr(again, name), getattr(depth, name))
    np.testing.assert_array_equal(again.surface.patch_size, depth.surface.patch_size)
    assert (again.pitch, again.image_size, again.preset) == (20.0, (40, 30), "balanced")
    assert (again.surface.first, again.surface.spacing) == ((-0.5, -0.5), 2.5)


def test_the_file_can_be_read_without_this_package(depth, tmp_path):
    depth.save(tmp_path / "d.npz")
    with np.load(tmp_path / "d.npz", allow_pickle=False) as data:
        assert data["mode"].tolist() == [1, -1, 0]
        np.testing.assert_allclose(data["magnification"], [5, 4, np.nan])


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 cut"])
def test_a_damaged_file_is_refused_by_name(content, tmp_path):
    path = tmp_path / "bad.npz"
    path.write_bytes(content)
    with pytest.raises(DepthFileError, match=r"bad\.npz"):
        DepthMap.load(path)


def test_pictures_of_one_camera_have_one_size_whatever_a_scene_at_about_one_depth_shows(depth):
    # As calibrated from three scenes, and analysed in five frames of each.
    sizes = set()
    for pitch in (69.95, 70.0, 70.06):
        for part in (0.3, 0.302, 0.305, 0.308, 0.31):
            one = replace(
                depth, patch_size=np.full(3, part * pitch), reason=np.zeros(3), pitch=pitch
            )
            sizes.add(PictureGrid((2043, 1971), pitch, default_scale(one)).size)
    assert sizes == {(607, 586)}


def test_the_scale_keeps_the_resolution_of_the_flat_to_a_tenth(depth):
    for size in np.linspace(1.5, 19.9, 40):
        one = replace(depth, patch_size=np.full(3, size), reason=np.zeros(3))
        assert abs(np.log2(default_scale(one) / size)) <= 1 / 8 + 1e-9
