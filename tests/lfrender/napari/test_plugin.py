"""The plugin for napari: its manifest, readers and widgets; napari itself need not be installed."""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np
import pytest

import lfcal
import lfrender
from lfrender.napari import readers, widgets

MANIFEST = Path(lfrender.__file__).parent / "napari" / "napari.yaml"


def test_manifest_is_valid_and_its_commands_exist():
    npe2 = pytest.importorskip("npe2", reason="the manifest is checked by npe2 (lfrender[napari])")
    manifest = npe2.PluginManifest.from_file(MANIFEST)
    manifest.validate_imports()
    assert len(manifest.contributions.widgets) == 3 and len(manifest.contributions.sample_data) == 2


def test_flats_cameras_and_depth_maps_are_read_as_layers_in_scene_coordinates(
    house, house_files, tmp_path
):
    calibration = house.truth.calibration
    depth = lfrender.analyze(house.flat, calibration, "fast")
    depth.save(tmp_path / "depth.npz")
    ((pixels, about, kind),) = readers.get_reader(str(house_files / "flat.png"))(
        str(house_files / "flat.png")
    )
    assert kind == "image" and about["rgb"]
    np.testing.assert_array_equal(pixels, house.flat)
    path = str(house_files / "camera.json")
    ((centres, _, kind),) = readers.get_reader(path)(path)
    assert kind == "points"
    np.testing.assert_allclose(centres[:, ::-1], calibration.lattice.centres())
    path = str(tmp_path / "depth.npz")
    ((_, about, kind),) = readers.get_reader(path)(path)
    assert kind == "image"
    np.testing.assert_allclose(about["translate"], depth.surface.first[::-1])


def test_files_of_other_programs_are_left_to_them(tmp_path):
    (tmp_path / "other.json").write_text('{"a": 1}')
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    assert readers.get_reader(str(tmp_path / "other.json")) is None
    assert readers.get_reader(str(tmp_path / "other.npz")) is None
    assert readers.get_reader("movie.xyz") is None


def test_widgets_calibrate_analyze_and_render(house, tmp_path):
    (points,) = widgets.calibrate(house.flat, save_to=tmp_path / "camera.json")
    assert points[2] == "points" and lfcal.load(
        tmp_path / "camera.json"
    ).lattice.pitch == pytest.approx(house.truth.calibration.lattice.pitch, abs=0.02)
    (depth,) = widgets.analyze(house.flat, tmp_path / "camera.json", "fast", tmp_path / "depth.npz")
    assert depth[2] == "image" and (tmp_path / "depth.npz").exists()
    layers = widgets.render(house.flat, tmp_path / "camera.json", "fast", 5.0)
    assert sorted(layer[1]["name"] for layer in layers) == ["magnification", "rendering"]
    with pytest.raises(lfcal.FlatError, match="choose a layer"):
        widgets.calibrate(None)


def test_widgets_show_controls_for_all_but_the_layer():
    pytest.importorskip(
        "magicgui", reason="napari makes its widgets by magicgui (lfrender[napari])"
    )
    from magicgui.type_map import get_widget_class

    for function in (widgets.calibrate, widgets.analyze, widgets.render):
        for name, parameter in inspect.signature(function).parameters.items():
            if name != "flat":
                # Strings are looked up as modules: of a name that this one imports, magicgui finds
                # nothing.
                assert not isinstance(parameter.annotation, str)
                assert get_widget_class(annotation=parameter.annotation, value=parameter.default)
