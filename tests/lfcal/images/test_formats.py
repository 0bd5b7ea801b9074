"""Containers of flats, each written by another program or by hand from its format."""

from __future__ import annotations

import hashlib
import json
import os
import struct

import numpy as np
import pytest
import tifffile

import lfcal

RNG = np.random.default_rng(4)


START = struct.pack(">4s4sII", b"\x89LFP", b"\r\n\x1a\n", 1, 0)


def section(kind: bytes, data: bytes) -> tuple[bytes, str]:
    """A section of a Lytro file, and its name."""
    name = "sha1-" + hashlib.sha1(data).hexdigest()
    head = struct.pack(">4s4sII", kind, b"\r\n\x1a\n", 0, len(data)) + name.encode().ljust(
        80, b"\0"
    )
    return (head + data).ljust(-(-(96 + len(data)) // 16) * 16, b"\0"), name


def lytro_file(picture: bytes, about: dict, *, archive: dict[str, bytes] | None = None) -> bytes:
    """A Lytro file of one picture, or an archive of files by their name."""

    parts = []
    table = {}
    if archive is None:
        blobs = {
            "imageRef": picture,
            "metadataRef": json.dumps(about).encode(),
            "privateMetadataRef": b'{"a": 1}',
        }
        frame = {}
        for key, data in blobs.items():
            part, frame[key] = section(b"\x89LFC", data)
            parts.append(part)
        table = {"frames": [{"frame": frame}], "thumbnails": []}
    else:
        table["files"] = []
        for name, data in archive.items():
            part, reference = section(b"\x89LFC", data)
            parts.append(part)
            table["files"].append({"name": name, "dataRef": reference})
    return START + section(b"\x89LFM", json.dumps(table).encode())[0] + b"".join(parts)


def pack(pixels, bits):
    """Packed bytes of pixels: 12 bits as the F01, 10 as the Illum."""
    p = pixels.ravel().astype(np.uint16)
    if bits == 12:
        a = p[0::2]
        b = p[1::2]
        return np.stack([a >> 4, (a & 15) << 4 | b >> 8, b & 255], 1).astype(np.uint8).tobytes()
    four = p.reshape(-1, 4)
    low = sum((four[:, k] & 3) << (2 * k) for k in range(4))
    return np.column_stack([four >> 2, low]).astype(np.uint8).tobytes()


def described(width, height, bits):
    packing = {"endianness": "big", "bitsPerPixel": bits}
    return {"image": {"width": width, "height": height, "rawDetails": {"pixelPacking": packing}}}


@pytest.mark.parametrize("bits", [10, 12])
def test_packed_lytro_pixels_are_read_as_they_were(tmp_path, bits):
    pixels = RNG.integers(0, 1 << bits, (20, 40), np.uint16)
    (tmp_path / "a.lfr").write_bytes(lytro_file(pack(pixels, bits), described(40, 20, bits)))
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "a.lfr"), pixels)


def test_lytro_bits_are_unpacked_as_imageio_does(monkeypatch):
    plugin = pytest.importorskip(
        "imageio.plugins.lytro", reason="the foreign reader of Lytro files is not installed"
    )
    from lfcal.images.lytro import unpack_pixels

    for bits, name, reader in (
        (10, "LYTRO_ILLUM_IMAGE_SIZE", plugin.LytroIllumRawFormat),
        (12, "LYTRO_F01_IMAGE_SIZE", plugin.LytroF01RawFormat),
    ):
        monkeypatch.setattr(plugin, name, (20, 40))
        data = RNG.integers(0, 256, 20 * 40 * bits // 8, np.uint8)
        foreign = reader.rearrange_bits(data.astype(np.uint16)) * ((1 << bits) - 1)
        np.testing.assert_array_equal(
            unpack_pixels(data.tobytes(), 40, 20, bits), np.rint(foreign).astype(np.uint16)
        )


def test_white_images_of_a_lytro_archive_are_its_pages(tmp_path):
    whites = [RNG.integers(0, 4096, (20, 40), np.uint16) for _ in range(2)]
    files = {}
    for k, white in enumerate(whites):
        files[f"C:\\CAL\\MOD_{k:04d}.RAW"] = pack(white, 12)
        files[f"C:\\CAL\\MOD_{k:04d}.TXT"] = json.dumps({"master": described(40, 20, 12)}).encode()
    (tmp_path / "data.C.0").write_bytes(lytro_file(b"", {}, archive=files))
    for k, white in enumerate(whites):
        np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "data.C.0", k), white)
    with pytest.raises(lfcal.FlatError, match="2 white images"):
        lfcal.read_flat(tmp_path / "data.C.0")


def test_a_lytro_file_of_finished_pictures_is_refused_with_what_it_holds(tmp_path):
    pictures = [section(b"\x89LFC", b"\xff\xd8\xff\xe0 picture %d" % k) for k in range(4)]
    depth = section(b"\x89LFC", bytes(1600))
    about = {"representation": "jpeg"}
    stack = {
        "imageArray": [
            about | {"imageRef": name, "lambda": k} for k, (_, name) in enumerate(pictures)
        ]
    }
    stack["depthLut"] = {"width": 20, "height": 20, "representation": "raw", "imageRef": depth[1]}
    kind = {"type": "com.lytro.acceleration.refocusStack", "vendorContent": stack}
    table = json.dumps({"picture": {"frameArray": [], "accelerationArray": [kind]}}).encode()
    parts = [START, section(b"\x89LFM", table)[0], depth[0], *(part for part, _ in pictures)]
    (tmp_path / "a-stk.lfp").write_bytes(b"".join(parts))
    with pytest.raises(lfcal.FlatError, match=r"4 finished pictures .*raw\.lfp"):
        lfcal.read_flat(tmp_path / "a-stk.lfp")


def test_hdf5_light_field_of_views_becomes_microimages(tmp_path):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs lfrender[hdf5]")
    views = RNG.integers(0, 256, (3, 5, 8, 10, 3), np.uint8)
    with h5py.File(tmp_path / "lf.h5", "w") as file:
        file.create_dataset("LF", data=views, compression="gzip")
        file.create_dataset("GT_DEPTH", data=np.zeros((3, 5, 8, 10), np.float32))
    flat = lfcal.read_flat(tmp_path / "lf.h5")
    assert flat.shape == (24, 50, 3)
    np.testing.assert_array_equal(flat[2 * 3 + 1, 4 * 5 + 3], views[1, 3, 2, 4])


@pytest.mark.parametrize("link", ["external", "soft", "storage", "virtual", "group"])
def test_hdf5_with_data_in_other_files_is_refused_and_nothing_else_is_opened(tmp_path, link):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs lfrender[hdf5]")
    other = tmp_path / "pipe"
    # To open a pipe would wait for its writer forever.
    os.mkfifo(other)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        if link == "external":
            file["flat"] = h5py.ExternalLink(str(other), "/flat")
        elif link == "group":
            file["data"] = h5py.ExternalLink(str(other), "/data")
        elif link == "soft":
            file["outside"] = h5py.ExternalLink(str(other), "/flat")
            file["flat"] = h5py.SoftLink("/outside")
        elif link == "storage":
            place = [(str(other), 0, 30 * 40)]
            file.create_dataset("flat", (30, 40), np.uint8, external=place)
        else:
            layout = h5py.VirtualLayout((30, 40), np.uint8)
            layout[:] = h5py.VirtualSource(str(other), "flat", (30, 40))
            file.create_virtual_dataset("flat", layout)
    with pytest.raises(lfcal.FlatError, match="copy"):
        lfcal.read_flat(tmp_path / "a.h5")


def test_hdf5_that_declares_more_than_its_bytes_can_hold_is_refused(tmp_path):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs lfrender[hdf5]")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        data = file.create_dataset(
            "flat", (2**15, 2**15), np.uint16, chunks=(2**14, 2**15), compression="gzip"
        )
        data.id.write_direct_chunk((0, 0), b"x" * 9)
        data.id.write_direct_chunk((2**14, 0), b"x" * 9)
    with pytest.raises(lfcal.FlatError, match="claim to hold"):
        lfcal.read_flat(tmp_path / "a.h5")


def test_hdf5_picture_and_its_white_image_are_read(tmp_path):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs lfrender[hdf5]")
    raw, white = RNG.integers(0, 65536, (2, 30, 40), np.uint16)
    with h5py.File(tmp_path / "a.vox", "w") as file:
        file.create_dataset("data/image", data=raw.astype(np.uint32), compression="gzip")
        file.create_dataset("data/white", data=white)
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "a.vox"), raw)
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "a.vox", 1), white)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file.create_dataset("one", data=raw)
        file.create_dataset("two", data=raw)
    with pytest.raises(lfcal.FlatError, match="holds 2 pictures"):
        lfcal.read_flat(tmp_path / "b.h5")


def test_hdf5_with_missing_chunks_is_refused(tmp_path):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs lfrender[hdf5]")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("flat", (100, 100), np.uint16, chunks=(10, 10))[:20] = 3
    with pytest.raises(lfcal.FlatError, match="chunks are missing"):
        lfcal.read_flat(tmp_path / "a.h5")
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file.create_dataset("flat", (1 << 18, 1 << 18), np.uint16, chunks=(1 << 10, 1 << 10))
    with pytest.raises(lfcal.FlatError, match="more than"):
        lfcal.read_flat(tmp_path / "b.h5")


@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_openexr_colours_and_grey_are_floats(tmp_path, kind):
    OpenEXR = pytest.importorskip("OpenEXR", reason="OpenEXR needs lfrender[exr]")
    pixels = RNG.random((20, 30, 3)).astype(kind)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": pixels}).write(str(tmp_path / "a.exr"))
    flat = lfcal.read_flat(tmp_path / "a.exr")
    assert flat.dtype == np.float32
    np.testing.assert_array_equal(flat, pixels.astype(np.float32))
    OpenEXR.File(header, {"Y": pixels[..., 0].copy()}).write(str(tmp_path / "b.exr"))
    np.testing.assert_array_equal(
        lfcal.read_flat(tmp_path / "b.exr"), pixels[..., 0].astype(np.float32)
    )


def test_truncated_openexr_and_one_of_an_impossible_size_are_refused(tmp_path):
    OpenEXR = pytest.importorskip("OpenEXR", reason="OpenEXR needs lfrender[exr]")
    header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}
    path = tmp_path / "a.exr"
    OpenEXR.File(header, {"Y": RNG.random((64, 64)).astype(np.float32)}).write(str(path))
    data = path.read_bytes()
    at = data.index(b"dataWindow\0box2i\0") + 21
    huge = data[:at] + struct.pack("<4i", 0, 0, 1 << 20, 1 << 20) + data[at + 16 :]
    for damaged, message in (
        (data[: len(data) // 2], "damaged or truncated OpenEXR"),
        (huge, "more than"),
    ):
        path.write_bytes(damaged)
        with pytest.raises(lfcal.FlatError, match=message):
            lfcal.read_flat(path)


def write_dng(path, pixels):
    """A DNG of a colour mosaic, as simple as LibRaw takes it."""
    import tifffile

    tags = [
        (33421, "H", 2, (2, 2), True),
        (33422, "B", 4, (0, 1, 1, 2), True),
        (50706, "B", 4, (1, 4, 0, 0), True),
        (50708, "s", 5, "None", True),
        (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True),
        (50714, "H", 1, 0, True),
        (50717, "H", 1, 4095, True),
        (271, "s", 5, "None", True),
        (272, "s", 5, "None", True),
    ]
    tifffile.imwrite(path, pixels, photometric="CFA", extratags=tags, metadata=None)


def test_dng_gives_the_mosaic_as_stored(tmp_path):
    pytest.importorskip("rawpy", reason="raw photos need lfrender[dng]")
    pixels = RNG.integers(0, 4096, (120, 160), np.uint16)
    write_dng(tmp_path / "a.dng", pixels)
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "a.dng"), pixels)


@pytest.mark.parametrize("version", [2, 3])
def test_ome_zarr_of_five_axes_is_read(tmp_path, version):
    zarr = pytest.importorskip("zarr", reason="Zarr needs lfrender[zarr]")
    pixels = RNG.integers(0, 65536, (1, 3, 1, 40, 50), np.uint16)
    group = zarr.open_group(str(tmp_path / "a.ome.zarr"), mode="w", zarr_format=version)
    for name, array in (("s0", pixels), ("s1", pixels[..., ::2, ::2])):
        group.create_array(name, data=array[:, :1], chunks=(1, 1, 1, 16, 16))
    scales = [{"datasets": [{"path": "s0"}, {"path": "s1"}], "axes": list("tczyx")}]
    group.attrs.update(
        {"multiscales": scales} if version == 2 else {"ome": {"multiscales": scales}}
    )
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "a.ome.zarr"), pixels[0, 0, 0])
    with lfcal.open_flat(tmp_path / "a.ome.zarr") as source:
        np.testing.assert_array_equal(source.read(5, 7, 30, 28), pixels[0, 0, 0, 7:28, 5:30])


@pytest.mark.parametrize(
    "suffix, tool", [(".ray", "RxLive"), (".czi", "Bio-Formats"), (".raw", r"\.yuv")]
)
def test_formats_that_are_not_read_name_the_tool_that_converts_them(tmp_path, suffix, tool):
    path = tmp_path / f"flat{suffix}"
    path.write_bytes(b"some other bytes " * 10)
    with pytest.raises(lfcal.FlatError, match=tool):
        lfcal.read_flat(path)


def test_truncated_files_of_every_container_are_refused(tmp_path):
    """Cut at any place in the first nine tenths: no picture, and no error but ours."""
    from benchmarks.stress.file_faults import _container_files

    grey = RNG.integers(0, 256, (120, 160), np.uint8)
    for name, whole in _container_files(tmp_path, grey).items():
        path = tmp_path / f"cut_{name}"
        path.write_bytes(whole)
        lfcal.read_flat(path, 0)
        for share in np.linspace(0.0, 0.9, 12):
            path.write_bytes(whole[: int(share * len(whole))])
            with pytest.raises(lfcal.FlatError, match="cut_"):
                lfcal.read_flat(path, 1 if path.suffix == ".yuv" else 0)


def test_signed_flats_after_a_dark_frame_are_unsigned_without_negative_light(tmp_path):
    pixels = RNG.integers(-50, 2500, (20, 40), np.int16)
    tifffile.imwrite(tmp_path / "flat.tif", pixels)
    flat = lfcal.read_flat(tmp_path / "flat.tif")
    assert flat.dtype == np.uint16
    np.testing.assert_array_equal(flat, np.maximum(pixels, 0))
