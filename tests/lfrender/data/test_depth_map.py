import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import lfrender
from lfcal import CalibrationError
from lfrender import DepthMap
from lfrender.data.depth_file import DepthFileError
from lfrender.data.depth_map import default_scale
from lfrender.data.rendering import PictureGrid
from lfrender.data.surface import Surface, constant_surface


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


@pytest.fixture(scope="module")
def analysed():
    flat, camera, _ = lfrender.data.example()
    return lfrender.analyze(flat, camera)


def _altered(depth, **changed):
    """A depth map with another surface, whose fields are given by their names."""
    surface = depth.surface
    fields = {"patch_size": surface.patch_size, "first": surface.first, "spacing": surface.spacing}
    return replace(depth, surface=Surface(**fields | changed))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda d: _altered(d, patch_size=d.surface.patch_size[:1, :1]), "lies not over the flat"),
        (
            lambda d: _altered(d, patch_size=np.resize(d.surface.patch_size, (3000, 3000))),
            "lies not over the flat",
        ),
        (lambda d: _altered(d, patch_size=-d.surface.patch_size), "surface contradicts"),
        (lambda d: replace(d, patch_size=-d.patch_size), "drawn contradicts"),
        (lambda d: replace(d, pitch=1.02 * d.pitch), "different cameras"),
        (lambda d: replace(d, image_size=(241, 180)), "different cameras"),
    ],
)
def test_a_depth_map_that_contradicts_itself_is_refused_when_it_is_loaded(
    analysed, tmp_path, make, message
):
    make(analysed).save(tmp_path / "d.npz")
    with pytest.raises(DepthFileError, match=rf"d\.npz: .*{message}"):
        DepthMap.load(tmp_path / "d.npz")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"confidence": [2.0]}, "confidence 2 is not from 0 to 1"),
        ({"standard_error": [-1.0]}, "standard_error -1 is not from 0 to inf"),
        ({"reason": [9]}, "reason 9 is not from 0 to 4"),
        ({"filled_patch_size": [1.0, 2.0]}, r"filled_patch_size cannot be float32 of shape \(2,\)"),
        ({"pitch": 0.0}, "pitch 0 is not from 1"),
    ],
)
def test_values_outside_their_ranges_are_refused_when_a_depth_map_is_made(changed, message):
    one = np.ones(1, np.float32)
    fields = dict.fromkeys(("patch_size", "standard_error", "confidence", "filled_patch_size"), one)
    fields |= {"surface": constant_surface(1.0), "pitch": 20.0, "image_size": (9, 9)}
    with pytest.raises(ValueError, match=message):
        DepthMap(**fields | changed)


_NEGATED = {name: lambda values: -values for name in ("patch_size", "drawn", "surface")}


@pytest.mark.parametrize(
    ("name", "change"),
    [
        *_NEGATED.items(),
        ("surface", lambda values: values[:0]),
        ("surface", lambda values: values[None]),
        ("surface", lambda values: np.full_like(values, 1e30)),
        ("surface_first", lambda values: values * np.inf),
        ("surface_spacing", lambda values: 0 * values),
        ("pitch", lambda values: 0 * values),
        ("pitch", lambda values: values[None]),
        ("image_size", lambda values: values.astype(float)),
        ("patch_size", lambda values: values.astype(str)),
        ("patch_size", lambda values: values[:-1]),
        ("preset", lambda _: np.array("\ud800")),
        ("lens_blur", lambda _: np.array('{"aperture": 1e300}')),
        ("centres", lambda values: values + np.nan),
        ("mode", lambda values: -values),
        ("reason", lambda values: 0 * values + 9),
        ("saved", lambda values: values + 5),
    ],
)
@pytest.mark.parametrize("digest", [True, False])
def test_wrong_arrays_of_a_file_are_refused_with_and_without_its_digest(
    analysed, tmp_path, name, change, digest
):
    analysed.save(tmp_path / "d.npz")
    with np.load(tmp_path / "d.npz") as file:
        data = dict(file)
    data[name] = change(data.get(name))
    if not digest:
        del data["digest"], data["camera"]
    np.savez(tmp_path / "d.npz", **data)
    with pytest.raises(DepthFileError, match=r"d\.npz: not a whole depth file") as caught:
        DepthMap.load(tmp_path / "d.npz")
    assert len(str(caught.value).encode().splitlines()) == 1


def test_files_without_digests_load_and_small_changes_are_noticed_by_the_digest(analysed, tmp_path):
    analysed.save(tmp_path / "d.npz")
    with np.load(tmp_path / "d.npz") as file:
        data = dict(file)
    data["surface"] = np.asfortranarray(data["surface"] * np.float32(1.01))
    np.savez(tmp_path / "d.npz", **data)
    with pytest.raises(DepthFileError, match="were changed after they were written"):
        DepthMap.load(tmp_path / "d.npz")
    for name in ("digest", "camera", "mode", "filled", "magnification"):
        del data[name]
    np.savez(tmp_path / "d.npz", **data)
    loaded = DepthMap.load(tmp_path / "d.npz")
    assert loaded.surface.patch_size.flags.c_contiguous
    np.testing.assert_array_equal(loaded.patch_size, analysed.patch_size)


def test_a_depth_map_of_another_camera_of_the_same_size_is_not_drawn(analysed):
    flat, camera, _ = lfrender.data.example()
    lattice = replace(camera.lattice, origin=camera.lattice.origin + 0.1 * camera.lattice.pitch)
    with pytest.raises(CalibrationError, match="another camera"):
        lfrender.render(flat, replace(camera, lattice=lattice), analysed)
    for wrong in (replace(analysed, pitch=30.0), _altered(analysed, spacing=0.1)):
        with pytest.raises(
            (CalibrationError, DepthFileError), match=r"camera|lies not over the flat"
        ):
            lfrender.render(flat, camera, wrong)


def test_a_large_surface_is_shown_in_a_second(analysed):
    pytest.importorskip("matplotlib")
    analysed._repr_html_()
    spacing = analysed.surface.spacing * analysed.surface.patch_size.shape[1] / 4000
    values = np.resize(analysed.surface.patch_size, (3000, 4000))
    large = _altered(analysed, patch_size=values, spacing=spacing)
    start = time.process_time()
    assert "<img" in large._repr_html_()
    assert time.process_time() - start < 1


def test_a_table_has_one_row_for_each_lens_with_and_without_pandas(monkeypatch):
    depth = lfrender.data.example()[2]
    monkeypatch.setitem(sys.modules, "pandas", None)
    plain = depth.to_table()
    assert isinstance(plain, np.recarray) and len(plain) == len(depth)
    np.testing.assert_array_equal(plain.patch_size, depth.patch_size)
    np.testing.assert_array_equal(plain.x, depth.centres[:, 0])
    assert set(plain["mode"]) <= {"telescopic", "binocular", "unresolved"}
    assert (plain["reason"][depth.mode != 0] == "resolved").all()
    monkeypatch.undo()
    pandas = pytest.importorskip("pandas")
    table = depth.to_table()
    assert isinstance(table, pandas.DataFrame) and list(table.columns) == list(plain.dtype.names)
