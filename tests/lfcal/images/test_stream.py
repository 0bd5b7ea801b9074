"""Flats read part by part: the pixels of `read_flat`, however the file is stored."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile

import lfcal

_PARTS = [(0, 0, 90, 100), (3, 5, 40, 77), (0, 31, 90, 33), (64, 96, 90, 100), (10, 0, 11, 1)]


def picture(dtype, channels):
    values = np.random.default_rng(3).random((100, 90, *channels))
    return values.astype(dtype) if np.dtype(dtype).kind == "f" else (values * 255).astype(dtype)


def assert_parts_are_those_of_the_whole(path, in_parts=True):
    whole = lfcal.read_flat(path)
    with lfcal.open_flat(path) as source:
        assert (source.shape, source.dtype, source.nbytes) == (
            whole.shape,
            whole.dtype,
            whole.nbytes,
        )
        assert source.in_parts == in_parts
        for left, top, right, bottom in _PARTS:
            part = source.read(left, top, right, bottom)
            assert part.dtype == whole.dtype
            np.testing.assert_array_equal(part, whole[top:bottom, left:right])


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32", "float64"])
@pytest.mark.parametrize("channels", [(), (3,), (4,)])
@pytest.mark.parametrize(
    "stored",
    [
        {},
        {"bigtiff": True},
        {"byteorder": ">"},
        {"tile": (32, 16)},
        {"rowsperstrip": 7, "compression": "zlib"},
        {"tile": (32, 48), "compression": "zlib", "byteorder": ">"},
    ],
    ids=lambda stored: "-".join(stored) or "plain",
)
def test_parts_of_a_tiff(tmp_path, dtype, channels, stored):
    path = tmp_path / "flat.tif"
    tifffile.imwrite(
        path, picture(dtype, channels), photometric="rgb" if channels else "minisblack", **stored
    )
    assert_parts_are_those_of_the_whole(path)


def test_parts_of_tiffs_with_planes_white_zero_and_single_bits(tmp_path):
    path = tmp_path / "flat.tif"
    planes = np.ascontiguousarray(np.moveaxis(picture("uint8", (3,)), -1, 0))
    for pixels, stored in (
        (planes, {"photometric": "rgb", "planarconfig": "separate", "rowsperstrip": 9}),
        (planes[0], {"photometric": "miniswhite"}),
        (planes[0] > 99, {"photometric": "minisblack"}),
    ):
        tifffile.imwrite(path, pixels, **stored)
        assert_parts_are_those_of_the_whole(path)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("shape", [(100, 90), (100, 90, 3), (3, 100, 90)])
def test_parts_of_a_zarr_array(tmp_path, version, shape):
    zarr = pytest.importorskip("zarr", minversion="3.0")
    path = tmp_path / "flat.zarr"
    array = zarr.create_array(
        path,
        shape=shape,
        dtype="uint16",
        chunks=tuple(min(n, 32) for n in shape),
        zarr_format=version,
    )
    array[...] = np.random.default_rng(1).integers(0, 60000, shape)
    assert_parts_are_those_of_the_whole(path)


@pytest.mark.parametrize("location", ["start", "end"])
def test_a_shard_without_one_of_its_chunks_is_refused_where_the_chunk_is_needed(tmp_path, location):
    zarr = pytest.importorskip("zarr", minversion="3.0")
    path = tmp_path / "flat.zarr"
    sharding = {"shape": (64, 64), "index_location": location}
    array = zarr.create_array(
        path, shape=(100, 90), dtype="uint16", chunks=(16, 16), shards=sharding
    )
    array[...] = np.random.default_rng(1).integers(1, 60000, (100, 90))
    assert_parts_are_those_of_the_whole(path)
    array[16:32, 32:48] = 0
    with lfcal.open_flat(path) as source:
        assert source.read(0, 0, 32, 100).shape == (100, 32)
        with pytest.raises(lfcal.FlatError, match="shard is missing or incomplete"):
            source.read(30, 0, 40, 20)
    with pytest.raises(lfcal.FlatError, match="incomplete"):
        lfcal.read_flat(path)


def test_a_file_of_another_kind_is_read_as_a_whole(tmp_path):
    from PIL import Image

    Image.fromarray(picture("uint8", (3,))).save(tmp_path / "flat.png")
    assert_parts_are_those_of_the_whole(tmp_path / "flat.png", in_parts=False)


def test_damage_and_nan_are_reported_with_the_file_name(tmp_path):
    path = tmp_path / "flat.tif"
    tifffile.imwrite(path, picture("uint8", (3,)), photometric="rgb")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(lfcal.FlatError, match=r"flat\.tif: truncated TIFF"):
        lfcal.open_flat(path)
    pixels = picture("float32", ())
    pixels[60, 50] = np.nan
    tifffile.imwrite(path, pixels)
    with lfcal.open_flat(path) as source:
        source.read(0, 0, 90, 60)
        with pytest.raises(lfcal.FlatError, match=r"flat\.tif: 1 values are NaN"):
            source.read(0, 0, 90, 61)
        with pytest.raises(ValueError, match="not on a flat of 90 x 100"):
            source.read(0, 0, 91, 10)


def test_dark_frame_is_subtracted_in_the_type_of_the_flat():
    flat = np.array([[[5, 90, 300]]], np.uint16)
    np.testing.assert_array_equal(
        lfcal.subtract_dark(flat, np.array([[7]], np.uint8)), [[[0, 83, 293]]]
    )
    assert lfcal.subtract_dark(flat, np.array([[7]], np.uint8)).dtype == np.uint16
    assert lfcal.subtract_dark(flat / np.float32(10), np.array([[1.0]], np.float32))[
        0, 0, 0
    ] == np.float32(-0.5)


def test_dark_frame_of_another_sensor_or_kind_is_refused():
    flat = np.zeros((4, 5), np.uint8)
    with pytest.raises(lfcal.FlatError, match="same sensor"):
        lfcal.subtract_dark(flat, np.zeros((5, 4), np.uint8))
    with pytest.raises(lfcal.FlatError, match="as the sensor stores"):
        lfcal.subtract_dark(flat, np.zeros((4, 5), np.uint16))


def test_parts_of_a_flat_are_those_of_the_whole_less_the_dark_frame(tmp_path):
    rng = np.random.default_rng(2)
    flat, dark = (rng.integers(0, top, (50, 40), np.uint16) for top in (900, 300))
    tifffile.imwrite(tmp_path / "flat.tif", flat)
    tifffile.imwrite(tmp_path / "dark.tif", dark)
    with lfcal.open_flat(tmp_path / "flat.tif", dark=tmp_path / "dark.tif") as source:
        assert source.in_parts and source.dark == tmp_path / "dark.tif"
        np.testing.assert_array_equal(
            source.read(3, 7, 21, 30), lfcal.subtract_dark(flat, dark)[7:30, 3:21]
        )


def test_dark_file_that_does_not_fit_the_flat_is_named_when_it_is_opened(tmp_path):
    tifffile.imwrite(tmp_path / "flat.tif", np.zeros((50, 40), np.uint8))
    tifffile.imwrite(tmp_path / "small.tif", np.zeros((40, 40), np.uint8))
    tifffile.imwrite(tmp_path / "deep.tif", np.zeros((50, 40), np.uint16))
    for name, message in (
        ("small.tif", r"\(40, 40\), the flat \(50, 40\)"),
        ("deep.tif", "as the sensor stores"),
        ("no", "no"),
    ):
        with pytest.raises(lfcal.FlatError, match=f"{name}.*{message}"):
            lfcal.open_flat(tmp_path / "flat.tif", dark=tmp_path / name)
