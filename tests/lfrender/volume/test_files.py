"""Volumes as files, in notebooks and in napari."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile

import lfrender
from lfcal import FlatError, OutputError
from lfrender.napari.readers import get_reader
from lfrender.volume.files import open_volume_file


def test_ome_tiff_holds_voxels_and_their_sizes(shell_volume, tmp_path):
    path = tmp_path / "volume.ome.tif"
    shell_volume.save(path)

    with tifffile.TiffFile(path) as tiff:
        data = tiff.asarray()
        about = tifffile.xml2dict(tiff.ome_metadata)["OME"]["Image"]
    pixels = about["Pixels"]

    assert np.array_equal(data, shell_volume.data)
    assert (pixels["SizeZ"], pixels["SizeC"], pixels["SizeT"]) == (len(shell_volume.data), 1, 1)
    assert [pixels[f"PhysicalSize{axis}"] for axis in "ZYX"] == pytest.approx(shell_volume.spacing)
    assert pixels["PhysicalSizeZUnit"] == "µm"
    assert json.loads(about["Description"])["fits"][0]["steps"] == shell_volume.fit.steps


def test_volumes_in_pixels_say_so_in_their_files(shells, tmp_path):
    volume = lfrender.reconstruct_volume(
        shells.flat, shells.calibration, depth_range=(-8, 8), planes=3, steps=1
    )
    volume.save(tmp_path / "volume.tif")

    with tifffile.TiffFile(tmp_path / "volume.tif") as tiff:
        pixels = tifffile.xml2dict(tiff.ome_metadata)["OME"]["Image"]["Pixels"]

    assert pixels["PhysicalSizeXUnit"] == "pixel"
    assert pixels["PhysicalSizeZUnit"] == "reference frame"


def test_ome_zarr_holds_voxels_sizes_and_place(shell_volume, tmp_path):
    zarr = pytest.importorskip("zarr")
    path = tmp_path / "volume.ome.zarr"
    shell_volume.save(path)

    group = zarr.open_group(str(path), mode="r")
    (scales,) = group.attrs["ome"]["multiscales"]
    dataset = scales["datasets"][0]
    scale, translation = dataset["coordinateTransformations"]

    assert np.array_equal(group["0"][:], shell_volume.data)
    assert [axis["unit"] for axis in scales["axes"]] == ["micrometer"] * 3
    assert scale["scale"] == pytest.approx(shell_volume.spacing)
    assert translation["translation"] == pytest.approx(shell_volume.origin)


def _lapse(volume, path):
    later = replace(volume, data=2 * volume.data)
    with open_volume_file(path, interval=0.25) as add:
        add(volume)
        add(later)
    return later


def test_a_time_lapse_is_one_tiff_with_times(shell_volume, tmp_path):
    later = _lapse(shell_volume, tmp_path / "lapse.ome.tif")

    with tifffile.TiffFile(tmp_path / "lapse.ome.tif") as tiff:
        pixels = tifffile.xml2dict(tiff.ome_metadata)["OME"]["Image"]["Pixels"]
        (series,) = tiff.series
        assert series.axes == "TZYX" and series.shape == (2, *shell_volume.data.shape)

    assert (pixels["TimeIncrement"], pixels["TimeIncrementUnit"]) == (0.25, "s")
    assert lfrender.Volume.load(tmp_path / "lapse.ome.tif", frame=1) == later
    with pytest.raises(ValueError, match="frame must be 0 to 1, got 2"):
        lfrender.Volume.load(tmp_path / "lapse.ome.tif", frame=2)


def test_a_time_lapse_is_one_zarr_with_times_and_levels(shell_volume, tmp_path):
    zarr = pytest.importorskip("zarr")
    wide = replace(shell_volume, data=np.tile(shell_volume.data[:3], (1, 3, 3)))
    path = tmp_path / "lapse.ome.zarr"
    later = _lapse(wide, path)

    group = zarr.open_group(str(path), mode="r")
    (scales,) = group.attrs["ome"]["multiscales"]
    first, second = scales["datasets"][:2]
    height, width = wide.data.shape[1:]
    ((data, look, _),) = get_reader(str(path))(str(path))

    assert scales["axes"][0] == {"name": "t", "type": "time", "unit": "second"}
    assert group["1"].shape == (2, 3, height // 2, width // 2)
    mean = later.data[1, :2, :2].mean()
    assert group["1"][1, 1, 0, 0] == pytest.approx(mean)
    assert max(group[scales["datasets"][-1]["path"]].shape[-2:]) <= 256
    spacing = first["coordinateTransformations"][0]["scale"]
    scale, translation = second["coordinateTransformations"]
    assert scale["scale"] == pytest.approx([*spacing[:2], *(2 * step for step in spacing[2:])])
    assert translation["translation"][3] == pytest.approx(wide.origin[2] + spacing[3] / 2)
    assert data.shape == (2, *wide.data.shape) and look["scale"][0] == 0.25


def test_volumes_of_different_grids_are_no_time_lapse(shell_volume, tmp_path):
    other = replace(shell_volume, origin=(0.0, 0.0, 0.0))
    with (
        pytest.raises(ValueError, match="same grid as those before"),
        open_volume_file(tmp_path / "lapse.ome.tif") as add,
    ):
        add(shell_volume)
        add(other)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["volume.ome.tif", "volume.ome.zarr"])
def test_volumes_come_back_from_their_files_and_as_layers_of_napari(shell_volume, tmp_path, name):
    if name.endswith("zarr"):
        pytest.importorskip("zarr")
    path = tmp_path / name
    shell_volume.save(path)

    ((data, look, kind),) = get_reader(str(path))(str(path))

    assert lfrender.Volume.load(path) == shell_volume
    assert kind == "image" and np.array_equal(data, shell_volume.data)
    assert look["scale"] == pytest.approx(shell_volume.spacing)


def test_other_files_are_no_volumes(tmp_path):
    tifffile.imwrite(tmp_path / "other.ome.tif", np.zeros((30, 40), np.uint8))
    with pytest.raises(FlatError, match="is no volume"):
        lfrender.Volume.load(tmp_path / "other.ome.tif")


@pytest.mark.parametrize("name", ["volume.png", "missing/volume.tif"])
def test_files_that_cannot_be_written_are_refused(shell_volume, tmp_path, name):
    with pytest.raises(OutputError):
        shell_volume.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_notebooks_show_three_projections_and_the_fit(shell_volume):
    page = shell_volume._repr_html_()
    across, along, side = shell_volume.projections()

    assert "data:image/png;base64," in page
    assert "residual" in page and f"{shell_volume.fit.noise:.1%}" in page
    deep, high, wide = shell_volume.data.shape
    assert (across.shape, along.shape, side.shape) == ((high, wide), (deep, wide), (high, deep))
    assert len(shell_volume.plot().axes) == 4


def test_napari_gets_the_volume_in_its_own_unit(shell_volume):
    data, look, kind = shell_volume.napari_layer()

    assert kind == "image" and data is shell_volume.data
    assert look["scale"] == shell_volume.spacing
    assert look["translate"][0] == pytest.approx(-9)
