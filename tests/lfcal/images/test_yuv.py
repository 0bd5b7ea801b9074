"""Raw planar video: the layout by name, camera file or samples, and the pixels of FFmpeg."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.images.video import RawLayout, find_layout
from lfcal.runtime.video import convert_frame

av = pytest.importorskip("av", reason="raw video is converted by PyAV (lfrender[video])")


def layout_of(folder, width, height, name):
    """The layout of a file of one frame, too large for any."""
    path = folder / "empty.yuv"
    path.write_bytes(bytes(width * height * 6))
    return find_layout(path, (width, height), name)


def make_planes(layout: RawLayout, seed=0):
    """Bytes of a smooth frame."""
    rng = np.random.default_rng(seed)
    kind = np.dtype("<u2" if layout.bits > 8 else np.uint8)
    values = rng.integers(
        16 << (layout.bits - 8), 235 << (layout.bits - 8), layout.frame_bytes // kind.itemsize
    )
    return values.astype(kind).tobytes()


@pytest.mark.parametrize("subsampling", ["420", "422", "444"])
@pytest.mark.parametrize("bits", [8, 10, 12])
@pytest.mark.parametrize("size", [(48, 32), (37, 21)])
def test_frames_have_the_pixels_that_ffmpeg_decodes(tmp_path, subsampling, bits, size):
    layout = layout_of(tmp_path, *size, f"{subsampling}p{bits}")
    path = tmp_path / f"film_{size[0]}x{size[1]}_{subsampling}p{bits}.yuv"
    path.write_bytes(make_planes(layout) + make_planes(layout, 1))
    options = {"video_size": f"{size[0]}x{size[1]}", "pixel_format": layout.pixel_format}
    assert lfcal.count_pages(path) == 2
    with av.open(str(path), format="rawvideo", options=options) as film:
        for number, frame in enumerate(film.decode(video=0)):
            deep = bits > 8
            expected = (
                frame.to_ndarray(format="rgb48le")
                if deep
                else convert_frame(frame, "rgb24").to_ndarray()
            )
            flat = lfcal.read_flat(path, number)
            assert flat.dtype == (np.uint16 if deep else np.uint8)
            np.testing.assert_array_equal(flat, expected)


@pytest.mark.parametrize(
    "name, expected",
    [
        ("Boys2_64x48_30fps_420p10.yuv", ("420", 10)),
        ("v003-64x48.yuv", ("420", 8)),
        ("a_64x48_yuv444p12le.yuv", ("444", 12)),
        ("a_64x48_p422_10bit.yuv", ("422", 10)),
        ("a_64x48_8b_400.yuv", ("400", 8)),
        ("Race_64x48_50_12b_444.yuv", ("444", 12)),
        ("a_64x48_gray8b.yuv", ("400", 8)),
        ("a_64x48_gray10le.yuv", ("400", 10)),
    ],
)
def test_layout_follows_from_the_name(tmp_path, name, expected):
    (tmp_path / name).write_bytes(bytes(64 * 48 * 6))
    layout = find_layout(tmp_path / name)
    assert (layout.width, layout.height) == (64, 48)
    bits = expected[1] if expected[1] != 8 or "8b" in name else layout.bits
    name = "gray" if expected[0] == "400" else f"yuv{expected[0]}p"
    assert layout.pixel_format == (name if bits == 8 else f"{name}{bits}le")


@pytest.mark.parametrize("bits", [8, 10, 12])
def test_bits_follow_from_the_samples(tmp_path, bits):
    layout = layout_of(tmp_path, 64, 48, f"420p{bits}")
    path = tmp_path / "v000-64x48.yuv"
    path.write_bytes(make_planes(layout) * 2)
    assert find_layout(path) == layout
    assert lfcal.count_pages(path) == 2


def test_size_follows_from_the_camera_file_beside_it_or_is_given(tmp_path):
    layout = layout_of(tmp_path, 64, 48, "420p8")
    path = tmp_path / "film.yuv"
    path.write_bytes(make_planes(layout))
    with pytest.raises(lfcal.FlatError, match=r"--size WxH"):
        lfcal.read_flat(path)
    assert lfcal.read_flat(path, size=(64, 48)).shape == (48, 64, 3)
    path.with_suffix(".cfg").write_text("IsKepler : 1\nLensletWidth : 64\nLensletHeight : 48\n")
    assert lfcal.read_flat(path).shape == (48, 64, 3)


def test_files_of_one_plane_are_grey_with_their_samples(tmp_path):
    samples = np.arange(48 * 64, dtype="<u2").reshape(48, 64) % 1024
    path = tmp_path / "grey_64x48_400p10.yuv"
    path.write_bytes(samples.tobytes())
    np.testing.assert_array_equal(lfcal.read_flat(path), samples)


@pytest.mark.parametrize(
    "length, options, message",
    [
        (100, {}, "truncated, or --size"),
        (4608 + 100, {"page": 1}, "frame 1 has 100 of 4608 bytes"),
        (4608 * 2, {}, "holds 2 frames"),
        (4608, {"page": 1}, "no frame 1"),
        (4608, {"size": (1 << 20, 1 << 20)}, "truncated"),
        (4608, {"pixel_format": "rgb24"}, "a pixel format is yuv420p"),
        (0, {}, "holds 0 bytes"),
    ],
)
def test_what_does_not_fit_is_refused_with_what_to_do(tmp_path, length, options, message):
    path = tmp_path / "film.yuv"
    path.write_bytes(b"\x90" * length)
    with pytest.raises(lfcal.FlatError, match=message) as error:
        lfcal.read_flat(path, **{"size": (64, 48)} | options)
    assert str(path) in str(error.value)
