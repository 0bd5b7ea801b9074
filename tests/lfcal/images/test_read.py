"""Reading flats: pixels as stored for every format; damaged and truncated files are refused."""

from __future__ import annotations

import io
import struct
import zlib

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from lfcal import FlatError
from lfcal.images.read import MAX_PIXELS, read_flat


@pytest.fixture
def rgb8():
    """A smooth picture whose three channels differ, so that a swapped order shows."""
    y, x = np.mgrid[:48, :64]
    return np.stack([x * 4, y * 5, 255 - x * 2], -1).astype(np.uint8)


@pytest.fixture
def rgb16(rgb8):
    return rgb8.astype(np.uint16) * 257 + np.uint16(1)


def png_bytes(pixels):
    bgr = pixels[..., ::-1] if pixels.ndim == 3 else pixels
    return cv2.imencode(".png", np.ascontiguousarray(bgr))[1].tobytes()


def encoded(pixels, extension):
    """A lossless or nearly lossless file of `pixels` in the format of `extension`, made without the
    toolkit.
    """
    bgr = np.ascontiguousarray(pixels[..., ::-1])
    settings = {".jpg": [cv2.IMWRITE_JPEG_QUALITY, 100], ".webp": [cv2.IMWRITE_WEBP_QUALITY, 101]}
    return cv2.imencode(extension, bgr, settings.get(extension, []))[1].tobytes()


@pytest.fixture
def check(tmp_path):
    """Asserts that a file of these bytes, whatever its name, holds these pixels."""

    def check(data, pixels, name="flat.tif"):
        (tmp_path / name).write_bytes(data)
        flat = read_flat(tmp_path / name)
        assert flat.dtype == pixels.dtype and flat.dtype.isnative and flat.flags.c_contiguous
        np.testing.assert_array_equal(flat, pixels)

    return check


def tiff_bytes(pixels, **options):
    stream = io.BytesIO()
    tifffile.imwrite(stream, pixels, **options)
    return stream.getvalue()


@pytest.mark.parametrize("extension", [".png", ".tif", ".webp", ".bmp", ".ppm"])
def test_rgb_is_read_exactly_and_in_rgb_order_whatever_the_name(check, rgb8, extension):
    for name in (f"flat{extension}", "flat.png", "flat.jpg", "flat.tif"):
        check(encoded(rgb8, extension), rgb8, name)


def test_jpeg_is_rgb_and_close_and_its_orientation_ignored(tmp_path, rgb8):
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(rgb8).save(tmp_path / "flat.jpg", exif=exif, quality=100, subsampling=0)
    assert np.abs(read_flat(tmp_path / "flat.jpg").astype(int) - rgb8).mean() < 2


@pytest.mark.parametrize("extension", [".png", ".tif", ".pgm", ".ppm"])
def test_grey_and_sixteen_bits_are_kept(check, rgb8, rgb16, extension):
    for grey in (rgb8[..., 0], rgb16[..., 0]) if extension != ".ppm" else ():
        check(cv2.imencode(extension, np.ascontiguousarray(grey))[1].tobytes(), grey)
    if extension != ".pgm":
        check(encoded(rgb16, extension), rgb16)


def test_alpha_is_dropped_without_blending(check, tmp_path, rgb8, rgb16):
    for rgb in (rgb8, rgb16):
        picture = np.dstack([rgb[..., ::-1], np.zeros(rgb.shape[:2], rgb.dtype)])
        check(cv2.imencode(".png", picture)[1].tobytes(), rgb)
    grey = rgb8[..., 0]
    Image.merge("LA", [Image.fromarray(grey), Image.new("L", grey.shape[::-1], 7)]).save(
        tmp_path / "flat.png"
    )
    np.testing.assert_array_equal(read_flat(tmp_path / "flat.png"), grey)


def test_palettes_become_colours_and_bits_black_and_white(tmp_path):
    indices = np.arange(64, dtype=np.uint8).reshape(8, 8) % 4
    palette = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [10, 20, 30]], np.uint8)
    image = Image.fromarray(indices, "P")
    image.putpalette(palette.ravel().tolist())
    image.save(tmp_path / "flat.png", transparency=bytes([0, 128, 255, 255]))
    np.testing.assert_array_equal(read_flat(tmp_path / "flat.png"), palette[indices])
    bits = np.indices((9, 9)).sum(0) % 2 == 0
    Image.fromarray(bits).save(tmp_path / "flat.png")
    np.testing.assert_array_equal(read_flat(tmp_path / "flat.png"), bits * np.uint8(255))


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_tiff_layouts(check, rgb16, compression):
    for options in (
        {},
        {"tile": (16, 16)},
        {"bigtiff": True},
        {"rowsperstrip": 5},
        {"byteorder": ">"},
    ):
        check(tiff_bytes(rgb16, photometric="rgb", compression=compression, **options), rgb16)


def test_tiff_with_planes_lzw_or_white_as_zero(check, tmp_path, rgb8, rgb16):
    check(tiff_bytes(np.moveaxis(rgb8, -1, 0), photometric="rgb", planarconfig="separate"), rgb8)
    check(tiff_bytes(rgb8[..., 0], photometric="miniswhite"), 255 - rgb8[..., 0])
    assert cv2.imwrite(
        str(tmp_path / "lzw.tif"), rgb16[..., ::-1], [cv2.IMWRITE_TIFF_COMPRESSION, 5]
    )
    np.testing.assert_array_equal(read_flat(tmp_path / "lzw.tif"), rgb16)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_float_tiff_is_float32(check, rgb8, dtype):
    pixels = (rgb8 / 256).astype(dtype)
    check(tiff_bytes(pixels, photometric="rgb"), pixels.astype(np.float32))


def test_thumbnail_in_a_tiff_is_skipped_and_a_second_picture_refused(tmp_path, rgb8):
    with tifffile.TiffWriter(tmp_path / "thumb.tif") as tiff:
        tiff.write(rgb8[::4, ::4].copy(), subfiletype=1, photometric="rgb")
        tiff.write(rgb8, photometric="rgb")
    np.testing.assert_array_equal(read_flat(tmp_path / "thumb.tif"), rgb8)
    tifffile.imwrite(tmp_path / "stack.tif", np.stack([rgb8[..., 0]] * 3), photometric="minisblack")
    with pytest.raises(FlatError, match="3 pictures"):
        read_flat(tmp_path / "stack.tif")


@pytest.mark.parametrize("maximum", [15, 100, 255, 1023, 65535])
def test_netpbm_values_are_not_rescaled(check, maximum):
    values = (np.arange(12).reshape(3, 4) * (maximum // 12)).astype(
        np.uint8 if maximum < 256 else np.uint16
    )
    head = b"\n# made by hand\n4 3\n%d\n" % maximum
    check(b"P2" + head + " ".join(map(str, values.ravel())).encode(), values)
    check(b"P5" + head + values.astype(values.dtype.newbyteorder(">")).tobytes(), values)
    rgb = np.dstack([values, values // 2, values * 0])
    check(b"P3" + head + " ".join(map(str, rgb.ravel())).encode(), rgb)
    check(b"P6" + head + rgb.astype(values.dtype.newbyteorder(">")).tobytes(), rgb)


@pytest.mark.parametrize("body", [b"", b"1 2 3", b"1 2 x 4", b"1 2 99 4"])
def test_netpbm_without_all_samples_is_refused(tmp_path, body):
    (tmp_path / "flat.pgm").write_bytes(b"P2 2 2 15\n" + body)
    with pytest.raises(FlatError, match="damaged image file"):
        read_flat(tmp_path / "flat.pgm")


@pytest.mark.parametrize("extension", ["png", "bmp"])
def test_indices_are_the_picture_where_all_colours_of_a_palette_are_equal(tmp_path, extension):
    indices = np.arange(64, dtype=np.uint8).reshape(8, 8)
    image = Image.fromarray(indices, "P")
    image.putpalette([0] * 768)
    image.save(tmp_path / f"flat.{extension}")
    np.testing.assert_array_equal(read_flat(tmp_path / f"flat.{extension}"), indices)


def test_nan_and_infinity_are_refused_with_their_number(tmp_path):
    pixels = np.zeros((8, 8), np.float32)
    pixels[1, 2], pixels[3, 4] = np.nan, -np.inf
    for bad, message in (
        (pixels, "2 values are NaN or infinite"),
        (np.full((8, 8), 1e300), "scale them"),
    ):
        tifffile.imwrite(tmp_path / "flat.tif", bad)
        with pytest.raises(FlatError, match=message):
            read_flat(tmp_path / "flat.tif")


def test_other_files_and_folders_are_refused_by_name(tmp_path):
    (tmp_path / "empty.png").touch()
    (tmp_path / "text.png").write_text("this is not a picture\n" * 9)
    for name, reason in [
        ("nowhere.png", "No such file"),
        ("empty.png", "is empty"),
        ("text.png", "no image"),
        ("", "folder"),
    ]:
        with pytest.raises(FlatError, match=reason) as caught:
            read_flat(tmp_path / name)
        assert str(tmp_path) in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("extension", [".png", ".jpg", ".bmp", ".ppm"])
def test_header_with_too_many_pixels_is_refused_before_decoding(tmp_path, rgb8, extension):
    data = bytearray(encoded(rgb8, extension))
    big = 65500 if extension == ".jpg" else 40000
    if extension == ".png":
        data[16:24] = struct.pack(">II", big, big)
        data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    elif extension == ".jpg":
        at = data.index(b"\xff\xc0")
        data[at + 5 : at + 9] = struct.pack(">HH", big, big)
    elif extension == ".bmp":
        data[18:26] = struct.pack("<ii", big, big)
    else:
        data = bytearray(b"P6\n%d %d\n255\n" % (big, big) + bytes(100))
    assert big * big > MAX_PIXELS
    path = tmp_path / f"bomb{extension}"
    path.write_bytes(data)
    with pytest.raises(FlatError, match="more than"):
        read_flat(path)


def test_png_with_correct_checksums_but_missing_rows_is_refused(tmp_path, rgb8, rgb16):
    for pixels in (rgb8, rgb16):
        data = png_bytes(pixels)
        at = data.index(b"IDAT")
        length = struct.unpack(">I", data[at - 4 : at])[0]
        half = zlib.decompress(data[at + 4 : at + 4 + length])[: pixels[:20].nbytes]
        body = b"IDAT" + zlib.compress(half)
        chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
        path = tmp_path / "flat.png"
        path.write_bytes(data[: at - 4] + chunk + data[at + 8 + length :])
        with pytest.raises(FlatError):
            read_flat(path)


def lossless_files(rgb8, rgb16, tmp_path):
    yield "flat.png", png_bytes(rgb8), rgb8
    yield "flat.png", png_bytes(rgb16), rgb16
    yield "flat.webp", encoded(rgb8, ".webp"), rgb8
    yield "flat.bmp", encoded(rgb8, ".bmp"), rgb8
    yield "flat.ppm", encoded(rgb8, ".ppm"), rgb8
    for compression in (None, "zlib"):
        tifffile.imwrite(
            tmp_path / "whole.tif", rgb16, photometric="rgb", compression=compression, metadata=None
        )
        yield "flat.tif", (tmp_path / "whole.tif").read_bytes(), rgb16
    cv2.imwrite(str(tmp_path / "lzw.tif"), rgb16[..., ::-1], [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    yield "flat.tif", (tmp_path / "lzw.tif").read_bytes(), rgb16


def test_truncated_files_are_refused_or_read_correctly(tmp_path, rgb8, rgb16):
    refused = 0
    path = tmp_path / "flat.jpg"
    noisy = (rgb8 // 2 + np.random.default_rng(5).integers(0, 100, rgb8.shape)).astype(np.uint8)
    path.write_bytes(encoded(noisy, ".jpg"))
    jpeg = path.name, path.read_bytes(), read_flat(path)
    for name, data, pixels in (jpeg, *lossless_files(rgb8, rgb16, tmp_path)):
        for end in {*np.linspace(1, len(data) - 1, 40).astype(int), len(data) // 2, len(data) - 1}:
            (tmp_path / name).write_bytes(data[:end])
            try:
                flat = read_flat(tmp_path / name)
            except FlatError as error:
                refused += 1
                assert "\n" not in str(error)
            else:
                np.testing.assert_array_equal(
                    flat, pixels, err_msg=f"{name} cut at {end} of {len(data)}"
                )
    assert refused > 290


def test_flipped_bits_raise_no_other_error(tmp_path, rgb8, rgb16, capfd):
    rng = np.random.default_rng(11)
    files = [*lossless_files(rgb8, rgb16, tmp_path), ("flat.jpg", encoded(rgb8, ".jpg"), rgb8)]
    for name, data, pixels in files:
        for _ in range(60):
            broken = bytearray(data)
            # Headers carry the dangerous fields, so half of the flips go there.
            at = rng.integers(0, 200 if rng.random() < 0.5 else len(data))
            broken[at % len(data)] ^= 1 << rng.integers(8)
            (tmp_path / name).write_bytes(broken)
            try:
                flat = read_flat(tmp_path / name)
            except FlatError as error:
                assert "\n" not in str(error)
            else:
                assert flat.dtype in (np.uint8, np.uint16, np.float32)
                assert flat.ndim == 2 or flat.shape[2] == 3
                if name == "flat.png":
                    np.testing.assert_array_equal(flat, pixels)
    assert capfd.readouterr().err == ""
