"""Writing pictures: pixels unchanged, the affine with them, refusals before anything is written."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms

from lfcal import read_flat
from lfcal.runtime.light.tone import encode_srgb
from lfrender.data.rendering import Rendering
from lfrender.output.formats import read_metadata
from lfrender.output.picture import PictureError, write_picture, write_stack

AFFINE = np.array([[2.5, 0.0, 1.25], [0.0, 2.5, -3.0]])


@pytest.fixture
def rendering():
    y, x = np.mgrid[:30, :40]
    image = np.stack([x * 6, y * 8, 255 - x * 6], -1).astype(np.uint8)
    valid = x > 3
    image[~valid] = 0
    return Rendering(image, AFFINE, valid, 1.0)


@pytest.mark.parametrize("extension", [".png", ".tif", ".TIFF"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("grey", [True, False])
def test_integer_pixels_come_back_exactly(tmp_path, rendering, extension, dtype, grey):
    pixels = rendering.image.astype(dtype) * dtype(257 if dtype == np.uint16 else 1)
    pixels = pixels[..., 0] if grey else pixels
    path = tmp_path / f"picture{extension}"
    write_picture(path, pixels)
    back = read_flat(path)
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, pixels)
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize("extension", [".jpg", ".webp"])
def test_lossy_formats_keep_the_colours(tmp_path, rendering, extension):
    write_picture(tmp_path / f"picture{extension}", rendering)
    assert (
        np.abs(read_flat(tmp_path / f"picture{extension}").astype(int) - rendering.image).mean() < 4
    )


def test_quality_of_lossy_formats(tmp_path, rendering):
    for name in ("a.jpg", "a.webp"):
        sizes = []
        for quality in (10, None, 100):
            write_picture(tmp_path / name, rendering, quality=quality)
            sizes.append((tmp_path / name).stat().st_size)
        assert sizes[0] < sizes[1] < sizes[2]
        write_picture(tmp_path / f"95{name}", rendering, quality=95)
        assert (tmp_path / f"95{name}").stat().st_size == sizes[1]
    with pytest.raises(PictureError, match=r"\.png has no quality"):
        write_picture(tmp_path / "a.png", rendering, quality=90)
    with pytest.raises(PictureError, match="quality must be from 1 to 100, got 0"):
        write_picture(tmp_path / "a.jpg", rendering, quality=0)


def test_affine_and_settings_travel_with_the_picture(tmp_path, rendering):
    def text_of(path):
        if path.suffix == ".tif":
            with tifffile.TiffFile(path) as tiff:
                return tiff.pages[0].description
        with Image.open(path) as image:
            return (
                image.info["comment"].decode()
                if path.suffix == ".jpg"
                else image.info["Description"]
            )

    for extension in (".tif", ".png", ".jpg"):
        path = tmp_path / f"picture{extension}"
        write_picture(path, rendering, settings={"preset": "fast"})
        description = json.loads(text_of(path))
        assert description["affine"] == AFFINE.tolist()
        assert description["preset"] == "fast"


@pytest.mark.parametrize("extension", [".png", ".tif", ".webp"])
@pytest.mark.parametrize("grey", [True, False])
def test_alpha_is_the_mask_of_valid_pixels(tmp_path, rendering, extension, grey):
    if grey:
        rendering = replace(rendering, image=rendering.image[..., 0])
    path = tmp_path / f"picture{extension}"
    write_picture(path, rendering, alpha=True)
    is_tiff = extension == ".tif"
    pixels = tifffile.imread(path) if is_tiff else np.asarray(Image.open(path).convert("RGBA"))
    np.testing.assert_array_equal(pixels[..., -1], rendering.valid * 255)


def test_formats_that_cannot_hold_the_pixels_are_refused(tmp_path, rendering):
    for name, pixels in [
        ("a.exr", rendering.image.astype(np.uint16)),
        ("a.jpg", rendering.image.astype(np.int64)),
        ("a.tif", rendering.image.astype(np.int64)),
        ("a.tif", rendering.image[..., :2]),
        ("a.tif", np.zeros((0, 5), np.uint8)),
    ]:
        with pytest.raises(PictureError):
            write_picture(tmp_path / name, pixels)
    with pytest.raises(PictureError, match="alpha"):
        write_picture(tmp_path / "a.jpg", rendering, alpha=True)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["a.jpg", "a.webp", "a.png"])
def test_pixels_that_a_format_cannot_hold_are_written_with_8_bits_up_to_white(
    tmp_path, rendering, name
):
    ramp = np.tile(np.linspace(0, 1, 64, dtype=np.float32), (48, 1))
    twelve = Rendering(
        (ramp * 4095).astype(np.uint16), rendering.affine, np.ones(ramp.shape, bool), 1.0, 4095.0
    )
    for picture, most in ((ramp, 3), (twelve, 3)):
        if name != "a.png" or picture is ramp:
            for tone, wanted in (("linear", ramp), ("auto", encode_srgb(ramp))):
                write_picture(tmp_path / name, picture, tone=tone)
                found = read_flat(tmp_path / name).astype(float).reshape(48, 64, -1)[..., 0]
                assert np.abs(found - 255 * wanted).max() <= most  # grey levels


@pytest.mark.parametrize("extension", [".png", ".jpg", ".webp", ".tif"])
def test_profile_and_camera_data_of_the_flat_are_kept(tmp_path, rendering, extension):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    exif = Image.Exif()
    exif[0x010F], exif[0x0100] = "Raytrix", 999
    flat = tmp_path / f"flat{extension}"
    pixels = Image.fromarray(np.zeros((40, 50, 3), np.uint8))
    pixels.save(flat, icc_profile=profile, **({} if extension == ".tif" else {"exif": exif}))
    found = read_metadata(flat)
    write_picture(tmp_path / f"picture{extension}", rendering, embedded=found)
    with Image.open(tmp_path / f"picture{extension}") as written:
        assert written.info["icc_profile"] == profile
        if extension != ".tif":
            assert written.getexif()[0x010F] == "Raytrix" and 0x0100 not in written.getexif()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_compressed_tiff_has_tiles_and_the_same_pixels(tmp_path, rendering, dtype):
    pixels = rendering.image.astype(dtype)
    write_picture(tmp_path / "picture.tif", pixels, compress=True)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "picture.tif"), pixels)
    with tifffile.TiffFile(tmp_path / "picture.tif") as file:
        assert file.pages[0].is_tiled and file.pages[0].compression.name == "ADOBE_DEFLATE"


@pytest.mark.parametrize("grey", [False, True])
def test_float_openexr_comes_back_exactly(tmp_path, rendering, grey):
    exr = pytest.importorskip("OpenEXR")
    pixels = rendering.image.astype(np.float32) / 300
    rendering = replace(rendering, image=pixels[..., 0] if grey else pixels)
    write_picture(tmp_path / "picture.exr", rendering)
    with exr.File(str(tmp_path / "picture.exr")) as file:
        np.testing.assert_array_equal(
            file.channels()["Y" if grey else "RGB"].pixels, rendering.image
        )
        assert "affine" in json.loads(file.header()["comments"])


def test_a_stack_in_a_picture_format_without_pages_is_numbered(tmp_path, rendering):
    paths = write_stack(
        tmp_path / "stack.png", [rendering, rendering.image[::-1]], settings=[{"k": 1}, {"k": 2}]
    )
    assert [path.name for path in paths] == ["stack_01.png", "stack_02.png"]
    np.testing.assert_array_equal(read_flat(paths[1]), rendering.image[::-1])
    with pytest.raises(PictureError, match="at least one"):
        write_stack(tmp_path / "none.tif", [])


def test_a_masked_picture_is_refused_rather_than_written_without_its_mask(tmp_path, rendering):
    with pytest.raises(PictureError, match="masked pixels"):
        write_picture(tmp_path / "picture.tif", np.ma.masked_less(rendering.image, 9))
    assert not list(tmp_path.iterdir())
