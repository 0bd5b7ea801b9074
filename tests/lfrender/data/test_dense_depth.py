"""Dense depth maps, depth pictures and point clouds, in files that other programs read."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

import lfcal
import lfrender
from lfrender.cli.main import main
from lfrender.data.dense_depth import EDGE, FILLED, SEEN, dense_depth, write_dense
from lfrender.output.point_cloud import point_cloud


@pytest.fixture(scope="module")
def depth(house):
    return lfrender.analyze(house.flat, house.truth.calibration, "fast")


def test_dense_depth_lies_on_the_grid_of_the_picture(house, depth):
    dense = dense_depth(depth)
    picture = lfrender.render(house.flat, house.truth.calibration, depth)
    assert dense.patch_size.shape == picture.image.shape[:2]
    np.testing.assert_allclose(dense.affine, picture.affine)
    wanted = house.truth.reference_patch_size
    fine = dense_depth(depth, 23.0 if depth.pitch > 23 else depth.pitch)
    v, u = np.mgrid[: fine.patch_size.shape[0], : fine.patch_size.shape[1]]
    scene = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ fine.affine.T
    to_reference = np.linalg.inv(np.vstack([house.truth.reference_affine, [0, 0, 1]]))
    x, y = np.rint(np.column_stack([scene, np.ones(len(scene))]) @ to_reference[:2].T).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < wanted.shape[1]) & (y < wanted.shape[0])
    error = np.abs(fine.patch_size.ravel()[inside] - wanted[y[inside], x[inside]])
    assert np.median(error) < 0.1


@pytest.mark.parametrize("ending", ["tif", "pfm"])
def test_dense_files_hold_the_numbers_as_they_are(depth, tmp_path, ending):
    dense = dense_depth(depth, 5)
    write_dense(tmp_path / f"d.{ending}", dense)
    if ending == "tif":
        with tifffile.TiffFile(tmp_path / "d.tif") as tiff:
            read = tiff.asarray()
            assert json.loads(tiff.pages[0].description)["affine"] == dense.affine.tolist()
    else:
        read = cv2.imread(str(tmp_path / "d.pfm"), cv2.IMREAD_UNCHANGED)
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, dense.patch_size)


def test_places_without_a_depth_are_marked_or_nan(depth, tmp_path):
    dense = dense_depth(depth, 5)
    bare = dense_depth(depth, 5, fill=False)
    assert (
        dense.resolved.mean() == pytest.approx((depth.mode != 0).mean(), abs=0.05)
        and not dense.resolved.all()
    )
    np.testing.assert_array_equal(np.isnan(bare.patch_size), ~dense.resolved)
    np.testing.assert_array_equal(bare.patch_size[dense.resolved], dense.patch_size[dense.resolved])
    write_dense(tmp_path / "d.tif", dense)
    validity, error = (tifffile.imread(tmp_path / "d.tif", key=page) for page in (1, 2))
    np.testing.assert_array_equal(validity, dense.validity)
    assert set(np.unique(validity)) == {FILLED, EDGE, SEEN}
    assert np.isinf(error[~dense.resolved]).all()
    # Few lenses with a depth have an unknown error.
    assert np.isfinite(error[dense.resolved]).mean() > 0.99
    steep = np.abs(np.diff(dense.patch_size, axis=1))[validity[:, 1:] == SEEN]
    assert steep.max() < 0.03 * depth.pitch + 0.01, "[px] where nothing is called an edge"


def test_points_lie_at_their_signed_virtual_depth_with_the_colours_of_the_scene(house, depth):
    points = point_cloud(house.flat, house.truth.calibration, depth)
    assert len(points) > 5000
    far = points["z"] > 0
    near = points["z"] < 0
    assert far.mean() > 0.3
    assert near.mean() > 0.1
    assert np.median(points["z"][far]) == pytest.approx(1 / 0.3, rel=0.05)
    width, height = depth.image_size
    assert points["x"].min() >= 0
    assert points["x"].max() < width / depth.pitch
    assert points["y"].max() < height / depth.pitch
    assert points["red"].std() > 10


def test_analyze_writes_every_form_that_is_asked_for(house_files, tmp_path):
    arguments = [
        "analyze",
        house_files / "flat.png",
        "-c",
        house_files / "camera.json",
        "-o",
        tmp_path / "d.npz",
    ]
    more = [
        "--dense",
        tmp_path / "d.pfm",
        "--picture",
        tmp_path / "d.png",
        "--ply",
        tmp_path / "d.ply",
        "--json",
    ]
    result = CliRunner().invoke(main, [str(a) for a in arguments + more], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert set(figures["saved"]) == {"blank", "ranges"}
    assert sum(figures["unresolved"].values()) == pytest.approx(figures["modes"]["unresolved"])
    assert lfcal.read_flat(tmp_path / "d.png").shape[2] == 3
    data = (tmp_path / "d.ply").read_bytes()
    header, body = data.split(b"end_header\n", 1)
    count = int(header.split(b"element vertex ")[1].split(b"\n")[0])
    assert count > 5000
    assert len(body) == 15 * count
    assert sorted(p.name for p in tmp_path.iterdir()) == ["d.npz", "d.pfm", "d.ply", "d.png"]
