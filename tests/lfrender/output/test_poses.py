"""Cameras of views: points of a simulated scene are projected to where views show them; files for
other programs.
"""

from __future__ import annotations

import functools
import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.cli.main import main
from lfrender.output.posed_files import write_posed_views
from lfrender.output.poses import view_rig
from lfrender.rendering.viewpoints import grid_offsets, still_depth, views_with_depth

SIZE = (420, 360)
PITCH = 22.0
RATIO = -0.3


@functools.cache
def shot():
    camera = Camera.design(size=SIZE, pitch=PITCH, rotation=1.0)
    return camera, simulate(
        SCENES["slope"](camera, left=-0.45, right=-0.25), camera, samples=12, seed=3
    )


def optics_of(camera, **more):
    return lfcal.Optics(
        camera.focal_length,
        camera.mla_distance,
        camera.sensor_distance,
        camera.pixel,
        principal_point=camera.principal_point,
        **more,
    )


@functools.cache
def drawn():
    capture = shot()[1]
    calibration = capture.truth.calibration
    depth = lfrender.analyze(capture.flat, calibration)
    offsets = grid_offsets(3, 3, 0.7 * calibration.lattice.radius)
    still = still_depth(depth)
    views = list(views_with_depth(capture.flat, calibration, depth, offsets=offsets, still=still))
    return depth, offsets, still, views


def rays_through(camera, offset, drawn_at):
    """Start and slope, in the axes of the scene [mm], of the ray that the lens at `drawn_at` shows
    at `offset`.
    """
    lens = (np.asarray(drawn_at) - camera.principal_point) * camera.pixel / camera.spread
    sensor = (np.asarray(drawn_at) + offset - camera.principal_point) * camera.pixel
    slope = (lens - sensor) / camera.sensor_distance
    start = lens + slope * camera.mla_distance
    return -start, -(slope - start / camera.focal_length)


@pytest.mark.parametrize("known", [True, False], ids=["metres", "baselines"])
def test_points_are_projected_to_where_their_rays_are_drawn_to_a_hundredth_of_a_pixel(known):
    camera, capture = shot()
    depth, offsets, still, views = drawn()
    optics = optics_of(camera) if known else None
    grid = views[0][0].affine, views[0][0].image.shape[1::-1]
    rig = view_rig(capture.truth.calibration, depth, offsets, *grid, still, optics)
    assert rig.unit == ("m" if known else "baseline")
    rng = np.random.default_rng(0)
    scene = rng.uniform(60, 300, (50, 2))
    ratio = rng.uniform(-0.5, -0.2, 50)
    z = camera.depth_at(ratio)
    points = camera.place(scene, z) * 1e-3
    if not known:
        slope = (scene - (np.array(SIZE) - 1) / 2) / max(SIZE)
        z = rig.depth(0, (ratio * PITCH)[None], np.zeros((1, 50, 2)))[0].astype(float)
        points = np.column_stack([slope * z[:, None], z])
    for number, (offset, (picture, _)) in enumerate(zip(offsets, views, strict=True)):
        found = rig.cameras[number].project(points)
        # Where the formula of docs/geometry.md draws the scene point, and, with optics, where a
        # traced ray comes from.
        where = scene + np.array(offset) / ratio[:, None] - np.array(offset) * PITCH / still
        pixel = (where - picture.affine[:, 2]) / picture.affine[0, 0]
        assert np.abs(found - pixel).max() < 0.01, "[px]"
        if known:
            start, slope = rays_through(camera, offset, scene + np.array(offset) / ratio[:, None])
            np.testing.assert_allclose(
                (start + slope * z[:, None]) * 1e-3, points[:, :2], atol=1e-7
            )


def test_optics_with_distortion_are_fitted_to_a_tenth_of_a_pixel():
    camera, capture = shot()
    depth, offsets, still, views = drawn()
    optics = optics_of(camera, radial=(-8.0, 0.0, 0.0), tilt=(0.002, -0.001), pupil=3.0)
    grid = views[0][0].affine, views[0][0].image.shape[1::-1]
    rig = view_rig(capture.truth.calibration, depth, offsets, *grid, still, optics)
    assert 0 < rig.error < 0.1, "RMS [px]"
    assert any(rig.cameras[0].distortion)


@pytest.mark.parametrize("known", [True, False], ids=["metres", "baselines"])
def test_nerfstudio_files_have_pictures_masks_and_depth_of_every_view(tmp_path, known):
    camera, capture = shot()
    depth, offsets, still, views = drawn()
    optics = optics_of(camera) if known else None
    rig = write_posed_views(
        tmp_path / "out",
        "nerfstudio",
        views,
        capture.truth.calibration,
        depth,
        offsets,
        still,
        optics,
    )
    model = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert len(model["frames"]) == 9 and model["unit"] == rig.unit
    frame = model["frames"][8]
    assert np.array(frame["transform_matrix"])[0, 3] > 0 > np.array(frame["transform_matrix"])[1, 3]
    picture = lfcal.read_flat(tmp_path / "out" / frame["file_path"])
    stored = cv2.imread(str(tmp_path / "out" / frame["depth_file_path"]), cv2.IMREAD_UNCHANGED)
    mask = lfcal.read_flat(tmp_path / "out" / frame["mask_path"])
    assert picture.shape[:2] == stored.shape == mask.shape == (frame["h"], frame["w"])
    assert stored.dtype == np.uint16 and set(np.unique(mask)) <= {0, 255}
    if known:
        true = camera.depth_at(-0.35) * 1e-3
        assert np.median(stored[stored > 0]) * model["depth_unit_scale_factor"] == pytest.approx(
            true, rel=0.1
        )


@pytest.fixture(scope="module")
def colmap(tmp_path_factory):
    """The folder of a COLMAP model, and the rig."""
    camera, capture = shot()
    depth, offsets, still, views = drawn()
    folder = tmp_path_factory.mktemp("colmap")
    truth = capture.truth.calibration
    return folder, write_posed_views(
        folder, "colmap", views, truth, depth, offsets, still, optics_of(camera)
    )


def test_colmap_reads_cameras_and_projects_points_as_they_are_drawn(colmap):
    pycolmap = pytest.importorskip(
        "pycolmap", reason="the foreign reader of COLMAP models is not installed"
    )
    folder, rig = colmap
    camera = shot()[0]
    model = pycolmap.Reconstruction(str(folder / "sparse" / "0"))
    point = camera.place((200.0, 180.0), camera.depth_at(-0.3)) * 1e-3
    for number, image in model.images.items():
        found = image.project_point(point) - 0.5
        np.testing.assert_allclose(
            found, rig.cameras[number - 1].project(point[None])[0], atol=1e-4
        )
        assert (folder / "masks" / f"{image.name}.png").exists()


def test_colmap_triangulates_the_points_from_their_tracks(colmap):
    """Each track, triangulated with the written poses alone, gives the written point; the views
    share most of them.
    """
    pycolmap = pytest.importorskip(
        "pycolmap", reason="the foreign reader of COLMAP models is not installed"
    )
    model = pycolmap.Reconstruction(str(colmap[0] / "sparse" / "0"))
    assert len(model.points3D) > 300 and model.compute_mean_track_length() > 7
    apart = []
    for point in model.points3D.values():
        images = [model.images[part.image_id] for part in point.track.elements]
        seen = np.array(
            [
                image.points2D[e.point2D_idx].xy
                for image, e in zip(images, point.track.elements, strict=True)
            ]
        )
        projected = np.array([image.project_point(point.xyz) for image in images])
        assert np.abs(projected - seen).max() < 1e-3, "[px]"
        cameras = [image.camera for image in images]
        poses = [image.cam_from_world() for image in images]
        found = pycolmap.estimate_triangulation(seen, poses, cameras)
        apart.append(np.abs(found["xyz"] / point.xyz - 1).max())
    assert np.max(apart) < 1e-3


def test_views_show_the_same_detail_along_a_track(colmap):
    lines = (colmap[0] / "sparse/0/images.txt").read_text().splitlines()
    tracks = [np.array(line.split(), float).reshape(-1, 3) for line in lines[1::2]]
    pictures = [
        cv2.imread(str(colmap[0] / "images" / line.split()[-1]), 0).astype(np.float32)
        for line in lines[::2]
    ]
    middle = {int(point): (x - 0.5, y - 0.5) for x, y, point in tracks[4]}
    shifts = []
    for x, y, point in tracks[0][::9]:
        patch = cv2.getRectSubPix(pictures[4], (15, 15), middle[int(point)])
        around = cv2.getRectSubPix(pictures[0], (21, 21), (x - 0.5, y - 0.5))
        agreement = cv2.matchTemplate(around, patch, cv2.TM_CCOEFF_NORMED)
        place = cv2.minMaxLoc(agreement)[3]
        shifts.append(np.array(place) - 3 if patch.std() > 6 else (0, 0))
    assert len(shifts) > 150 and np.mean(np.abs(shifts).max(1) > 0) < 0.03, "share moved by a pixel"


def matrix(path):
    """(h, w, channels) of a file of COLMAP, read as its documentation reads it."""
    data = path.read_bytes()
    width, height, channels = (int(word) for word in data.split(b"&", 3)[:3])
    values = np.frombuffer(data.split(b"&", 3)[3], "<f4")
    return values.reshape((width, height, channels), order="F").transpose(1, 0, 2)


def test_depth_maps_for_stereo_fusion_hold_the_depth_of_the_views(colmap):
    folder, rig = colmap
    for number, camera in enumerate(rig.cameras):
        depth = matrix(folder / f"stereo/depth_maps/view_{number:03d}.png.geometric.bin")[..., 0]
        assert depth.shape == camera.size[::-1]
        exact = cv2.imread(str(folder / f"depth/view_{number:03d}.png"), cv2.IMREAD_UNCHANGED)
        step = float((folder / "depth" / "unit.txt").read_text().split()[3])
        np.testing.assert_allclose(depth, exact * step, atol=0.51 * step)
    # The marks of the points: each lies in its pixel at the depth of the model.
    lines = (folder / "sparse/points3D.txt").read_text().splitlines()
    points = np.array([line.split()[1:4] for line in lines], float)
    u, v = np.rint(rig.cameras[4].project(points)).astype(int).T
    middle = matrix(folder / "stereo/depth_maps/view_004.png.geometric.bin")[..., 0]
    np.testing.assert_allclose(middle[v, u], points[:, 2] - rig.cameras[4].position[2], rtol=1e-5)


def test_normals_for_stereo_fusion_are_units_towards_the_camera(colmap):
    folder, rig = colmap
    depth = matrix(folder / "stereo/depth_maps/view_004.png.geometric.bin")[..., 0]
    normals = matrix(folder / "stereo/normal_maps/view_004.png.geometric.bin")
    v, u = np.nonzero(depth)
    rays = rig.cameras[4].rays(np.column_stack([u, v]))
    assert (np.sum(normals[v, u] * rays, 1) < 0).all()
    np.testing.assert_allclose(np.linalg.norm(normals[v, u], axis=1), 1, atol=1e-5)


def test_colmap_fuses_the_views_into_the_surfaces_that_they_show(colmap, tmp_path):
    pycolmap = pytest.importorskip(
        "pycolmap", reason="the foreign reader of COLMAP models is not installed"
    )
    folder, rig = colmap
    fused = pycolmap.stereo_fusion(str(tmp_path), str(folder))
    points = np.array([point.xyz for point in fused.points3D.values()])
    assert len(points) > 1000
    middle = matrix(folder / "stereo/depth_maps/view_004.png.geometric.bin")[..., 0]
    height, width = middle.shape
    pixels = np.rint(rig.cameras[4].project(points)).astype(int)
    inside = ((pixels >= 0) & (pixels < [width, height])).all(1)
    u, v = pixels[inside].T
    apart = np.abs((points[inside, 2] - rig.cameras[4].position[2]) / middle[v, u] - 1)
    assert np.median(apart[middle[v, u] > 0]) < 0.01


def test_rvs_files_hold_disparity_between_the_depths_that_they_state(tmp_path):
    pytest.importorskip("av", reason="raw video is written by PyAV (lfrender[video])")
    camera, capture = shot()
    depth, offsets, still, views = drawn()
    write_posed_views(
        tmp_path / "out",
        "rvs",
        views[:2],
        capture.truth.calibration,
        depth,
        offsets[:2],
        still,
        optics_of(camera),
    )
    model = json.loads((tmp_path / "out" / "cameras.json").read_text())
    one = model["cameras"][0]
    width, height = one["Resolution"]
    data = np.fromfile(tmp_path / "out" / f"v00_depth_{width}x{height}_yuv420p16le.yuv", "<u2")
    assert len(data) == width * height * 3 // 2
    near, far = one["Depth_range"]
    z = 1 / (data[: width * height].reshape(height, width) / 65535 * (1 / near - 1 / far) + 1 / far)
    x, y = np.array(one["Principle_point"]) - 0.5
    assert z[round(y), round(x)] == pytest.approx(camera.depth_at(-0.34) * 1e-3, rel=0.15)
    assert one["Position"][1] > 0 and model["cameras"][1]["Position"][1] == pytest.approx(
        0, abs=1e-9
    )


@pytest.mark.parametrize("kind", ["nerfstudio", "colmap", "rvs"])
def test_command_writes_posed_views(house_files, tmp_path, kind):
    words = [
        "views",
        str(house_files / "flat.png"),
        "-c",
        str(house_files / "camera.json"),
        "-o",
        str(tmp_path / "v"),
    ]
    done = CliRunner().invoke(
        main, [*words, "--grid", "1x2", "--poses", kind, "--scale", "5", "--json"]
    )
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["unit"] == "baseline"


def test_quilt_has_the_leftmost_view_at_the_bottom_left_and_the_name_that_was_asked_for(
    house_files, tmp_path
):
    words = ["views", str(house_files / "flat.png"), "-c", str(house_files / "camera.json")]
    words += ["-o", str(tmp_path / "q.png"), "--quilt", "3x2", "--scale", "4", "--json"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    (path,) = tmp_path.iterdir()
    assert path.name == "q.png" and json.loads(done.stdout)["views"] == str(path)
    flat = lfcal.read_flat(house_files / "flat.png")
    calibration = lfcal.load(house_files / "camera.json")
    radius = 0.7 * calibration.lattice.radius
    (left,) = lfrender.views(flat, calibration, offsets=[(-radius, 0.0)], scale=4.0)
    quilt, (height, width) = lfcal.read_flat(path), left.image.shape[:2]
    assert quilt.shape == (2 * height, 3 * width, 3)
    np.testing.assert_array_equal(quilt[height:, :width], left.image)
