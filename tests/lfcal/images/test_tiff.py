"""TIFF files of all kinds: their pixels as the tags describe them, or a clear refusal."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

import lfcal

Y, X = np.mgrid[:48, :64]
GREY = (X * 4).astype(np.uint8)
RGB = np.stack([X * 4, Y * 5, 255 - X * 2], -1).astype(np.uint8)
GREY_16 = GREY.astype(np.uint16) * 257 + np.uint16(3)
RGB_16 = RGB.astype(np.uint16) * 257 + np.uint16(3)


@pytest.fixture
def read(tmp_path):
    """Reads what tifffile wrote, as a whole and in parts, which have to be equal."""

    def read(pixels, **stored):
        path = tmp_path / "flat.tif"
        tifffile.imwrite(path, pixels, metadata=None, **stored)
        flat = lfcal.read_flat(path)
        with lfcal.open_flat(path) as source:
            assert source.in_parts
            np.testing.assert_array_equal(source.read(3, 5, 40, 44), flat[5:44, 3:40])
        return flat

    return read


@pytest.mark.parametrize("compression", ["lzw", "zstd", "packbits", "png", "jpegxl", "lzma"])
@pytest.mark.parametrize("pixels", [GREY, GREY_16, RGB, RGB_16], ids=["8", "16", "rgb8", "rgb16"])
@pytest.mark.parametrize("tile", [None, (16, 32)])
def test_compressed_pixels_are_read_exactly(read, compression, pixels, tile):
    lossless = {"compressionargs": {"lossless": True}} if compression == "jpegxl" else {}
    kind = "rgb" if pixels.ndim == 3 else "minisblack"
    flat = read(pixels, photometric=kind, compression=compression, tile=tile, **lossless)
    assert flat.dtype == pixels.dtype
    np.testing.assert_array_equal(flat, pixels)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_ignored_with_any_compression(read, orientation):
    tag = [(274, "H", 1, orientation, True)]
    for compression in (None, "lzw", "zlib"):
        flat = read(RGB, photometric="rgb", compression=compression, extratags=tag)
        np.testing.assert_array_equal(flat, RGB)


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_packed_bits_keep_their_values_and_white_as_zero_is_inverted_in_their_range(read, bits):
    values = GREY_16 >> (16 - bits)
    # The highest bit of a sample is stored first, and each row begins with a whole byte.
    split = values[..., None] >> np.arange(bits)[::-1] & 1
    rows = np.packbits(split.reshape(len(values), -1).astype(np.uint8), axis=1)
    strips = [rows[k : k + 8].tobytes() for k in range(0, len(rows), 8)]
    packed = {"shape": values.shape, "dtype": "uint16", "bitspersample": bits, "rowsperstrip": 8}
    flat = read(iter(strips), photometric="minisblack", **packed)
    np.testing.assert_array_equal(flat, values)
    inverted = read(iter(strips), photometric="miniswhite", **packed)
    np.testing.assert_array_equal(inverted, (1 << bits) - 1 - values)


def test_white_as_zero_is_inverted_for_16_and_1_bits(read):
    for compression in (None, "lzw"):
        flat = read(GREY_16, photometric="miniswhite", compression=compression)
        np.testing.assert_array_equal(flat, 65535 - GREY_16)
    np.testing.assert_array_equal(read(GREY > 99, photometric="miniswhite"), (GREY <= 99) * 255)


@pytest.mark.parametrize("extra", ["unassalpha", "assocalpha", "unspecified"])
@pytest.mark.parametrize("compression", [None, "lzw"])
def test_alpha_is_dropped_and_does_not_change_the_colours(read, extra, compression):
    rgba = np.dstack([RGB, GREY])
    flat = read(rgba, photometric="rgb", extrasamples=[extra], compression=compression)
    np.testing.assert_array_equal(flat, RGB)


def test_jpeg_in_a_tiff_is_rgb(read):
    luminance, red, blue = np.moveaxis(cv2.cvtColor(RGB, cv2.COLOR_RGB2YCrCb), 2, 0)
    for kind, pixels in (("rgb", RGB), ("ycbcr", np.dstack([luminance, blue, red]))):
        stored = {"compression": "jpeg", "compressionargs": {"level": 100}}
        flat = read(pixels, photometric=kind, **stored)
        assert np.abs(flat.astype(int) - RGB).mean() < 2


def test_palettes_of_8_bits_in_16_and_of_equal_colours_are_read(read):
    palette = np.random.default_rng(0).integers(0, 256, (3, 256)).astype(np.uint16)
    for colormap in (palette, palette * 257):
        flat = read(GREY, photometric="palette", colormap=colormap)
        np.testing.assert_array_equal(flat, palette.T[GREY])
    flat = read(GREY, photometric="palette", colormap=palette * 0)
    np.testing.assert_array_equal(flat, GREY)


@pytest.mark.parametrize(
    ("pixels", "stored", "reason"),
    [
        (GREY.astype(np.float32), {"photometric": "miniswhite"}, "unsigned integers only"),
        (GREY.astype(np.int16), {"photometric": "miniswhite"}, "unsigned integers only"),
        (RGB, {"photometric": "ycbcr", "subsampling": (1, 1)}, "save as RGB"),
        (np.dstack([RGB, GREY]), {"photometric": "separated"}, "SEPARATED with 4 samples"),
        (np.dstack([GREY] * 4), {"photometric": "minisblack"}, "MINISBLACK with 4 samples"),
        (np.dstack([GREY] * 7), {"photometric": "minisblack"}, "MINISBLACK with 7 samples"),
        (GREY.astype(np.complex64), {"photometric": "minisblack"}, "type complex64"),
        (GREY_16.astype(np.uint32) * 9, {"photometric": "minisblack"}, "above 65535"),
    ],
)
def test_pixels_of_other_kinds_are_refused_by_their_kind(read, pixels, stored, reason):
    planes = {"planarconfig": "contig"} if pixels.ndim == 3 else {}
    with pytest.raises(lfcal.FlatError, match=reason):
        read(pixels, **stored, **planes)


def test_integers_of_32_bits_are_read_where_they_fit_into_16(read):
    flat = read(GREY_16.astype(np.uint32), photometric="minisblack")
    assert flat.dtype == np.uint16
    np.testing.assert_array_equal(flat, GREY_16)


def test_a_page_that_may_be_a_thumbnail_is_never_taken_for_the_flat(tmp_path):
    path = tmp_path / "flat.tif"
    small = RGB[::4, ::4].copy()
    with tifffile.TiffWriter(path) as tiff:
        tiff.write(small, photometric="rgb", compression="lzw")
        tiff.write(RGB, photometric="rgb", compression="lzw")
    with pytest.raises(lfcal.FlatError, match=r"2 pictures.*--page"):
        lfcal.read_flat(path)
    np.testing.assert_array_equal(lfcal.read_flat(path, 1), RGB)
    with tifffile.TiffWriter(path) as tiff:
        tiff.write(small, photometric="rgb", subfiletype=1, subifds=1)
        tiff.write(GREY_16, photometric="minisblack", compression="lzw")
    np.testing.assert_array_equal(lfcal.read_flat(path), GREY_16)


@given(
    tag=st.sampled_from([256, 257, 258, 259, 262, 273, 277, 278, 279, 284, 317, 322, 338, 339]),
    value=st.one_of(st.integers(0, 20), st.integers(0, 2**32 - 1)),
    compression=st.sampled_from([None, "lzw", "zlib", "zstd", "jpeg"]),
)
@settings(max_examples=150)
def test_a_changed_tag_raises_one_line_or_gives_a_picture(
    tmp_path_factory, tag, value, compression
):
    path = tmp_path_factory.mktemp("changed") / "flat.tif"
    tifffile.imwrite(path, RGB, photometric="rgb", compression=compression, metadata=None)
    with tifffile.TiffFile(path) as tiff:
        if tag not in tiff.pages[0].tags:
            return
        entry = tiff.pages[0].tags[tag].offset
    data = bytearray(path.read_bytes())
    # Type LONG, one value.
    data[entry + 2 : entry + 12] = struct.pack("<HII", 4, 1, value)
    path.write_bytes(data)
    try:
        flat = lfcal.read_flat(path)
    except lfcal.FlatError as error:
        assert "\n" not in str(error)
    else:
        assert flat.dtype in (np.uint8, np.uint16, np.float32)
        # Nothing that is not in the file is made up: no more pixels than are stored.
        assert flat.size <= RGB.size


@pytest.mark.parametrize("compression", [None, "lzw", "zlib", "packbits", "zstd"])
@pytest.mark.parametrize(
    ("tag", "value"),
    [("ImageWidth", 32), ("ImageWidth", 128), ("ImageLength", 20), ("BitsPerSample", 4)],
)
def test_tags_that_do_not_fit_the_stored_bytes_are_refused(tmp_path, compression, tag, value):
    path = tmp_path / "flat.tif"
    stored = {"photometric": "minisblack", "compression": compression, "rowsperstrip": 13}
    tifffile.imwrite(path, GREY, metadata=None, **stored)
    whole = path.read_bytes()
    with tifffile.TiffFile(path) as tiff:
        entry = tiff.pages[0].tags[tag].valueoffset
    path.write_bytes(whole[:entry] + struct.pack("<H", value) + whole[entry + 2 :])
    with pytest.raises(lfcal.FlatError):
        lfcal.read_flat(path)


def changed(path, tag, value):
    """Give the first number of a tag of 16 bits, or all equal ones, another value."""
    data = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as tiff:
        entry = tiff.pages[0].tags[tag]
    size = {3: 2, 4: 4}[int(entry.dtype)]
    number = value.to_bytes(size, "little")
    count = entry.count if tag == "BitsPerSample" else 1
    data[entry.valueoffset : entry.valueoffset + size * count] = number * count
    path.write_bytes(data)


@pytest.mark.parametrize("compression", ["jpeg", "png", "webp", "jpegxl", "jpeg2000"])
@pytest.mark.parametrize(
    ("tag", "value"),
    [
        ("ImageWidth", 32),
        ("ImageWidth", 4096),
        ("ImageLength", 43),
        ("BitsPerSample", 1),
        ("PlanarConfiguration", 10),
    ],
)
def test_pictures_in_strips_have_the_size_and_bits_of_the_tags(tmp_path, compression, tag, value):
    path = tmp_path / "flat.tif"
    stored = {"photometric": "rgb", "compression": compression, "rowsperstrip": 13}
    tifffile.imwrite(path, RGB[:44], metadata=None, **stored)
    assert lfcal.read_flat(path).shape == (44, 64, 3)
    changed(path, tag, value)
    with pytest.raises(lfcal.FlatError):
        lfcal.read_flat(path)


@pytest.mark.parametrize(
    ("pixels", "compression", "tag", "value"),
    [
        (GREY_16, None, "ImageWidth", 63),
        (GREY_16, None, "BitsPerSample", 15),
        (GREY, "lzw", "ImageWidth", 63),
        (GREY, "zlib", "ImageLength", 47),
        (GREY, None, "Compression", 2),
        (GREY, "lzw", "Compression", 4),
        (GREY, "packbits", "Compression", 1),
        (RGB, "zlib", "Predictor", 3),
        (GREY, None, "StripOffsets", 8),
        (GREY, None, "StripOffsets", 225),
    ],
)
def test_tags_that_give_other_pixels_of_the_same_bytes_are_refused(
    tmp_path, pixels, compression, tag, value
):
    path = tmp_path / "flat.tif"
    noise = np.random.default_rng(0).integers(0, 2, pixels.shape).astype(pixels.dtype)
    stored = {"photometric": "rgb" if pixels.ndim == 3 else "minisblack", "rowsperstrip": 13}
    if tag == "Predictor":
        stored["predictor"] = True
    tifffile.imwrite(path, pixels + noise, metadata=None, compression=compression, **stored)
    assert lfcal.read_flat(path).shape == pixels.shape
    changed(path, tag, value)
    with pytest.raises(lfcal.FlatError):
        lfcal.read_flat(path)


def test_tiles_of_edges_opaque_alpha_and_padded_strips_are_read(read, tmp_path):
    for compression in ("webp", "jpeg", "png"):
        rgba = np.dstack([RGB, np.full_like(GREY, 255)])
        pixels = RGB if compression == "jpeg" else rgba
        stored = {"compression": compression, "tile": (32, 48), "photometric": "rgb"}
        assert read(pixels, **stored).shape == RGB.shape
    # Some programs fill strips up to whole words.
    path = tmp_path / "padded.tif"
    tifffile.imwrite(path, GREY[:, :63], metadata=None)
    with tifffile.TiffFile(path) as tiff:
        entry = tiff.pages[0].tags["StripByteCounts"].valueoffset
    size = 48 * 63
    data = path.read_bytes() + bytes(3)
    path.write_bytes(data[:entry] + struct.pack("<I", size + 3) + data[entry + 4 :])
    np.testing.assert_array_equal(lfcal.read_flat(path), GREY[:, :63])
