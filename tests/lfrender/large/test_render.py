"""Large flats drawn tile by tile: the same bits as at once, files that appear whole, runs that can
be continued.
"""

from __future__ import annotations

import functools
import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate


@functools.cache
def capture():
    """A house behind branches on a small flat, its camera, one with a gain map lens by lens, and
    the depth.
    """
    camera = Camera.design(size=(230, 200), pitch=17.2, lattice="hex", rotation=1.3)
    shot = simulate(SCENES["house"](camera), camera, samples=6, seed=2)
    plain = shot.truth.calibration
    own = (1 + 0.2 * np.sin(np.arange(len(plain.lattice)))).astype(np.float32)
    own[7] = 0
    gain = replace(lfcal.calibrate(shot.white, kind="white").gain_map, lens_gain=own)
    return (
        shot.flat,
        plain,
        replace(plain, gain_map=gain),
        lfrender.analyze(shot.flat, plain, "fast"),
    )


def drawn_in_tiles(tmp_path, flat, camera, tile, *, name="picture.tif", stored=None, **options):
    tifffile.imwrite(
        tmp_path / "flat.tif",
        flat,
        photometric="rgb" if flat.ndim == 3 else "minisblack",
        **stored or {},
    )
    with lfcal.open_flat(tmp_path / "flat.tif") as source:
        return lfrender.render_large(source, tmp_path / name, camera, tile=tile, **options)


@pytest.mark.parametrize("tile", [23, 64, None])
@pytest.mark.parametrize(
    "way", ["depth", "fixed", "blended", "small", "gain", "gain fixed", "mosaic", "float"]
)
def test_tiles_make_the_picture_of_the_whole_flat_bit_for_bit(tmp_path, way, tile):
    flat, plain, shaded, depth = capture()
    camera = shaded if way.startswith("gain") else plain
    options = {
        "fixed": {"patch_size": 6.5},
        "gain fixed": {"patch_size": 6.5},
        "blended": {"patch_size": -6.0, "blend": True, "scale": 9.3},
        "small": {"depth": depth, "scale": 3.0},
    }.get(way, {"depth": depth})
    if way == "mosaic":
        flat = flat[:, :, 1].copy()
        camera = replace(camera, mosaic="GRBG")
    if way == "float":
        flat = (flat / 255).astype(np.float32)
    whole = lfrender.render(flat, camera, **options)
    made = drawn_in_tiles(tmp_path, flat, camera, tile, **options)
    picture = lfcal.read_flat(tmp_path / "picture.tif")
    assert picture.dtype == whole.image.dtype
    np.testing.assert_array_equal(picture, whole.image)
    np.testing.assert_array_equal(made.affine, whole.affine)
    assert made.valid == pytest.approx(whole.valid.mean())
    rows, columns = whole.image.shape[:2]
    assert made.tiles == (1 if tile is None else -(-rows // tile) * -(-columns // tile))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["flat.tif", "picture.tif"]


class Killed(Exception):
    """Stands for the end of a process."""


def killed_after(count):
    def progress(done, _):
        if done == count:
            raise Killed

    return progress


# What was killed closes nothing.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("name", ["picture.tif", "picture.zarr"])
def test_a_killed_run_leaves_no_picture_and_is_continued_from_the_finished_tiles(tmp_path, name):
    if name.endswith("zarr"):
        pytest.importorskip("zarr", minversion="3.0")
    flat, camera, _, depth = capture()
    with pytest.raises(Killed):
        drawn_in_tiles(tmp_path, flat, camera, 31, name=name, depth=depth, progress=killed_after(3))
    assert not (tmp_path / name).exists()
    drawn: list[int] = []
    with lfcal.open_flat(tmp_path / "flat.tif") as source:
        made = lfrender.render_large(
            source,
            tmp_path / name,
            camera,
            depth,
            tile=31,
            progress=lambda done, _: drawn.append(done),
        )
    # The fourth was being stored.
    assert made.kept in (3, 4)
    assert drawn == list(range(made.kept + 1, made.tiles + 1))
    whole = lfrender.render(flat, camera, depth)
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / name), whole.image)
    assert made.valid == pytest.approx(whole.valid.mean())
    assert sorted(p.name for p in tmp_path.iterdir()) == ["flat.tif", name]


# What was killed closes nothing.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_run_with_other_settings_starts_from_the_beginning(tmp_path):
    flat, camera, _, _ = capture()
    with pytest.raises(Killed):
        drawn_in_tiles(tmp_path, flat, camera, 31, patch_size=6.5, progress=killed_after(3))
    with lfcal.open_flat(tmp_path / "flat.tif") as source:
        made = lfrender.render_large(
            source, tmp_path / "picture.tif", camera, patch_size=-6.5, tile=31
        )
    assert made.kept == 0
    whole = lfrender.render(flat, camera, patch_size=-6.5)
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "picture.tif"), whole.image)


@pytest.mark.parametrize("name", ["picture.tif", "packed.tif", "picture.png", "picture.zarr"])
def test_files_written_by_tiles_equal_files_written_at_once(tmp_path, name):
    if name.endswith("zarr"):
        pytest.importorskip("zarr", minversion="3.0")
    flat, camera, _, _ = capture()
    options = {"alpha": True, "compress": name == "packed.tif", "settings": {"patch_size": 6.5}}
    stored = {"tile": (32, 48), "compression": "zlib"}
    drawn_in_tiles(tmp_path, flat, camera, 31, name=name, patch_size=6.5, stored=stored, **options)
    whole = lfrender.render(flat, camera, patch_size=6.5)
    if name.endswith("zarr"):
        import zarr

        found = zarr.open_array(tmp_path / name, mode="r")
        np.testing.assert_array_equal(found[..., :3], whole.image)
        np.testing.assert_array_equal(found[..., 3] > 0, whole.valid)
        assert json.loads(found.attrs["description"])["affine"] == whole.affine.tolist()
        return
    lfrender.write_picture(tmp_path / f"one_{name}", whole, **options)
    assert (tmp_path / name).read_bytes() == (tmp_path / f"one_{name}").read_bytes()


@pytest.mark.parametrize("name", ["picture.tif", "picture.zarr"])
def test_a_list_of_finished_tiles_without_the_tiles_is_ignored(tmp_path, monkeypatch, name):
    """A run may be killed between moving the picture to its place and removing the list."""
    if name.endswith("zarr"):
        pytest.importorskip("zarr", minversion="3.0")
    flat, camera, _, _ = capture()
    with monkeypatch.context() as patch:
        patch.setattr("lfrender.output.resume.Checkpoint.remove", lambda self: None)
        drawn_in_tiles(tmp_path, flat, camera, 31, name=name, patch_size=6.5)
    assert (tmp_path / f".{name}.unfinished" / "state.json").exists()
    with lfcal.open_flat(tmp_path / "flat.tif") as source:
        made = lfrender.render_large(source, tmp_path / name, camera, patch_size=6.5, tile=31)
    assert made.kept == 0
    whole = lfrender.render(flat, camera, patch_size=6.5)
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / name), whole.image)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["flat.tif", name]
