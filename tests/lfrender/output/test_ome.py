"""OME-TIFF, OME-Zarr, OpenEXR depth and PCD, as other programs read them."""

from __future__ import annotations

import json

import numpy as np
import pytest
import tifffile

import lfcal
import lfrender
from lfrender.data.dense_depth import FILLED, SEEN, DenseDepth, write_dense
from lfrender.output.point_cloud import write_points

AFFINE = np.array([[3.2, 0.0, 1.1], [0.0, 3.2, 1.1]])


def rendering(shape, kind=np.uint16):
    pixels = np.random.default_rng(2).integers(0, 200, shape).astype(kind)
    return lfrender.Rendering(pixels, AFFINE, np.ones(shape[:2], bool), 7.0)


@pytest.mark.parametrize("shape", [(40, 50), (40, 50, 3)])
def test_ome_tiff_says_axes_sizes_and_our_description(tmp_path, shape):
    picture = rendering(shape)
    lfrender.write_picture(tmp_path / "a.ome.tif", picture, settings={"preset": "fast"})
    with tifffile.TiffFile(tmp_path / "a.ome.tif") as tiff:
        assert tiff.is_ome and tiff.series[0].axes == "YXS"[: len(shape)]
        pixels = tifffile.xml2dict(tiff.ome_metadata)["OME"]["Image"]
        np.testing.assert_array_equal(tiff.asarray(), picture.image)
    assert pixels["Pixels"]["PhysicalSizeX"] == pytest.approx(3.2)
    assert json.loads(pixels["Description"])["affine"] == AFFINE.tolist()
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "a.ome.tif"), picture.image)


@pytest.mark.parametrize("shape", [(40, 50), (40, 50, 3)])
@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_ome_zarr_says_where_its_pixels_lie_and_is_read_again(tmp_path, shape, kind):
    zarr = pytest.importorskip("zarr", reason="Zarr needs lfrender[zarr]")
    picture = rendering(shape, kind)
    lfrender.write_picture(tmp_path / "a.zarr", picture)
    group = zarr.open_group(str(tmp_path / "a.zarr"), mode="r")
    scales = dict(group.attrs)["ome"]["multiscales"][0]
    assert [axis["name"] for axis in scales["axes"]] == list("cyx"[3 - len(shape) :])
    scale, moved = scales["datasets"][0]["coordinateTransformations"]
    assert scale["scale"][-2:] == [3.2, 3.2] and moved["translation"][-2:] == [1.1, 1.1]
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "a.zarr"), picture.image)
    assert [path.name for path in tmp_path.iterdir()] == ["a.zarr"]


def test_ome_zarr_is_read_by_its_reference_reader(tmp_path):
    reader = pytest.importorskip(
        "ome_zarr.reader", reason="the foreign reader ome-zarr is not installed"
    )
    parse = pytest.importorskip("ome_zarr.io").parse_url
    picture = rendering((40, 50, 3))
    lfrender.write_picture(tmp_path / "a.zarr", picture)
    (node,) = list(reader.Reader(parse(str(tmp_path / "a.zarr")))())
    np.testing.assert_array_equal(np.moveaxis(np.asarray(node.data[0]), 0, -1), picture.image)


def test_dense_depth_as_openexr_is_read_by_its_library(tmp_path):
    OpenEXR = pytest.importorskip("OpenEXR", reason="OpenEXR needs lfrender[exr]")
    sizes = np.linspace(-9, -4, 30 * 40, dtype=np.float32).reshape(30, 40)
    validity = np.where(sizes > -5, SEEN, FILLED).astype(np.uint8)
    write_dense(
        tmp_path / "d.exr", DenseDepth(sizes, AFFINE, 23.2, validity, np.full_like(sizes, 0.02))
    )
    with OpenEXR.File(str(tmp_path / "d.exr"), separate_channels=True) as file:
        np.testing.assert_array_equal(file.channels()["Y"].pixels, sizes)
        np.testing.assert_array_equal(file.channels()["resolved"].pixels, sizes > -5)
        np.testing.assert_array_equal(file.channels()["standard_error"].pixels, np.float32(0.02))
        assert json.loads(file.header()["comments"])["pitch"] == 23.2


def test_pcd_holds_the_points_and_colours_of_ply(tmp_path):
    kind = [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
    ]
    points = np.array([(1, 2, 3, 10, 20, 30), (4, 5, 6, 255, 0, 1)], kind)
    write_points(tmp_path / "a.pcd", points)
    data = (tmp_path / "a.pcd").read_bytes()
    head, body = data.split(b"DATA binary\n")
    assert b"POINTS 2" in head and b"FIELDS x y z rgb" in head
    stored = np.frombuffer(body, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
    np.testing.assert_array_equal(stored["z"], [3, 6])
    np.testing.assert_array_equal(stored["rgb"], [0x0A141E, 0xFF0001])
