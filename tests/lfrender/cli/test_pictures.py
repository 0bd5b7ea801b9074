"""Pictures, views and depth that commands write."""

from __future__ import annotations

import json
import os

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms

import lfcal
import lfrender


def test_analyze_then_render_with_its_depth_or_without_gives_the_same_picture(
    ask, tmp_path, figures_of
):
    depth = tmp_path / "depth.npz"
    analysed = figures_of(*ask("analyze", "-o", depth))
    assert analysed["modes"]["telescopic"] > 0.3 and analysed["modes"]["binocular"] > 0.1
    assert sum(analysed["modes"].values()) == pytest.approx(1)
    drawn = figures_of(*ask("render", "--depth", depth, "-o", tmp_path / "two.tif"))
    assert set(drawn["seconds"]) == {"read", "calibrate", "analyze", "render", "write"}
    with tifffile.TiffFile(tmp_path / "two.tif") as tiff:
        description = json.loads(tiff.pages[0].description)
        picture = tiff.asarray()
    assert list(picture.shape[1::-1]) == drawn["size"]
    assert picture.dtype == np.uint8 and picture.std() > 20
    assert description["affine"] == drawn["affine"]
    assert (description["rendering"], description["preset"]) == ("all in focus", "balanced")
    figures_of(*ask("render", "-o", tmp_path / "one.tif"))
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "one.tif"), picture)
    assert sorted(os.listdir(tmp_path)) == ["depth.npz", "one.tif", "two.tif"]


def test_render_writes_ome_zarr_where_the_name_says_so(ask, tmp_path, figures_of):
    zarr = pytest.importorskip("zarr", minversion="3.0", reason="Zarr needs lfrender[zarr]")
    figures_of(*ask("render", "--patch-size", -5, "-o", tmp_path / "a.ome.zarr"))
    assert (
        "multiscales" in dict(zarr.open_group(str(tmp_path / "a.ome.zarr"), mode="r").attrs)["ome"]
    )
    figures_of(*ask("render", "--patch-size", -5, "-o", tmp_path / "a.zarr"))
    assert zarr.open_array(str(tmp_path / "a.zarr"), mode="r").ndim == 3


def test_render_calibrates_from_the_flat_or_a_white_image(house, house_files, tmp_path, figures_of):
    for options, source in [((), "scene"), (("--white", house_files / "white.png"), "white")]:
        drawn = figures_of(
            "render", house_files / "flat.png", *options, "-o", tmp_path / "picture.png"
        )
        assert drawn["camera_source"] == source
        assert drawn["pitch"] == pytest.approx(house.camera.pitch, abs=0.1)


@pytest.mark.parametrize(
    "words", [("render",), ("render", "--patch-size", "5"), ("refocus", "--patch-size", "5")]
)
def test_resize_gives_the_size_and_keeps_the_scene(house, ask, tmp_path, figures_of, words):
    output = tmp_path / "picture.png"
    figures_of(*ask(*words, "--resize", "210x165", "-o", output))
    assert lfcal.read_flat(output).shape[:2] == (165, 210)
    with Image.open(output) as image:
        affine = np.array(json.loads(image.info["Description"])["affine"])
    # The last pixel lies where it does on the flat of 420 x 330 px.
    np.testing.assert_allclose(affine @ [209, 164, 1], [418.5, 328.5], atol=2)


@pytest.mark.parametrize(
    "words",
    [
        ("render", "--patch-size", 5, "-o", "picture.jpg"),
        ("render", "--patch-size", 5, "--tile", 200, "-o", "picture.jpg"),
        ("refocus", "--patch-size", 5, "-o", "picture.webp"),
        ("views", "--preset", "fast", "--grid", "1x1", "--format", "jpg", "-o", "views"),
        ("views", "--preset", "fast", "--animation", 2, "-o", "round.webp"),
    ],
)
def test_quality_chooses_between_size_and_error(ask, tmp_path, figures_of, words):
    *words, output = words
    sizes = []
    for quality in (5, 60, 100):
        folder = tmp_path / str(quality)
        folder.mkdir()
        figures_of(*ask(*words, folder / output, "--quality", quality))
        (made,) = (path for path in folder.rglob("*") if path.is_file())
        sizes.append(made.stat().st_size)
    assert sizes[0] < 0.7 * sizes[1] < 0.5 * sizes[2]


@pytest.mark.parametrize(
    ("command", "name", "words"),
    [
        ("render", "picture.png", ()),
        ("render", "picture.tif", ("--tile", 200)),
        ("refocus", "picture.tif", ("--stack", 3)),
        ("views", "views", ()),
        ("views", "views", ("--format", "yuv")),
        ("views", "round.gif", ("--animation", 4)),
        ("views", "scene", ("--poses", "nerfstudio")),
        ("batch", "frames", ("--format", "png")),
        ("batch", "frames", ("--format", "yuv", "--views", "2x2")),
        ("batch", "film.mkv", ()),
    ],
)
def test_quality_is_refused_before_any_work_for_formats_that_have_none(
    ask, tmp_path, run, assert_refused, command, name, words
):
    asked = ask(command, *words, "-o", tmp_path / name, "--quality", 80)
    assert_refused(run(*asked), "has no quality; leave it out, or use .jpg or .webp")
    assert_refused(run(*asked[:-1], 101), "'--quality'", "1<=x<=100")
    assert not list(tmp_path.iterdir())


def test_scale_is_the_number_of_pixels_per_pitch(house, ask, tmp_path, figures_of):
    drawn = figures_of(
        *ask("render", "--patch-size", "5", "--scale", "10", "-o", tmp_path / "picture.png")
    )
    assert drawn["scale"] == pytest.approx(10)
    assert drawn["size"] == pytest.approx(
        [n / house.camera.pitch * 10 for n in house.truth.calibration.image_size], rel=0.1
    )
    mean = figures_of(*ask("render", "--traditional", "-o", tmp_path / "t.png"))
    assert mean["scale"] == pytest.approx(1, rel=0.1)
    assert np.prod(mean["size"]) == pytest.approx(len(house.truth.mode), rel=0.35)


def test_refocus_draws_one_depth_and_blend_is_its_mean_over_lenses(
    ask, tmp_path, run, figures_of, assert_refused
):
    figures_of(*ask("refocus", "-o", tmp_path / "a.tif", "--patch-size", 6))
    for name, options in (("crisp.tif", []), ("blend.tif", ["--blend"])):
        figures_of(*ask("render", "-o", tmp_path / name, "--patch-size", 6, *options))
    pictures = [tifffile.imread(tmp_path / name) for name in ("a.tif", "blend.tif", "crisp.tif")]
    # Mixing lenses that see a place out of focus takes detail from the picture.
    detail = [np.abs(np.diff(image.astype(float), axis=1)).mean() for image in pictures]
    assert detail[0] < 0.95 * detail[1] < 0.9 * detail[2]
    assert_refused(run(*ask("refocus", "-o", tmp_path / "b.tif")), "--patch-size, --at and --stack")
    assert_refused(run(*ask("render", "-o", tmp_path / "b.tif", "--blend")), "--blend needs")


def test_a_focal_stack_is_written_from_far_to_near_with_the_profile_of_the_flat(
    house_files, tmp_path, run, figures_of, assert_refused
):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    with Image.open(house_files / "flat.png") as image:
        image.save(tmp_path / "flat.png", icc_profile=profile)
    words = [tmp_path / "flat.png", "-c", house_files / "camera.json"]
    figures_of("analyze", *words, "-o", tmp_path / "depth.npz", "--preset", "fast")
    common = ["refocus", *words, "--depth", tmp_path / "depth.npz", "--scale", 5]
    found = figures_of(*common, "-o", tmp_path / "stack.tif", "--stack", 4)
    ratios = 1 / np.array(found["patch_sizes"])
    # The house has a telescopic background and binocular branches in front of it.
    assert ratios[0] > 0 > ratios[-1] and (np.diff(ratios) < 0).all()
    with tifffile.TiffFile(tmp_path / "stack.tif") as tiff:
        assert [json.loads(page.description)["patch_size"] for page in tiff.pages] == found[
            "patch_sizes"
        ]
        assert bytes(tiff.pages[3].tags[34675].value) == profile
        pages = tiff.asarray()
    sizes = [word for size in found["patch_sizes"][:2] for word in ("--patch-size", size)]
    given = figures_of(*common, "-o", tmp_path / "s.png", *sizes)
    assert given["pictures"] == [str(tmp_path / "s_01.png"), str(tmp_path / "s_02.png")]
    for path, page in zip(given["pictures"], pages, strict=False):
        with Image.open(path) as image:
            np.testing.assert_array_equal(np.asarray(image), page)
    assert figures_of(*common, "-o", tmp_path / "at.png", "--at", 200, 150)["picture"] == str(
        tmp_path / "at.png"
    )
    assert_refused(
        run(*common, "-o", tmp_path / "b.tif", "--at", 200, 150, "--stack", 3), "exclude each other"
    )


def test_alpha_marks_the_pixels_nothing_has_seen(ask, tmp_path, figures_of):
    drawn = figures_of(
        *ask("render", "--patch-size", "-6", "--alpha", "-o", tmp_path / "picture.tif")
    )
    alpha = tifffile.imread(tmp_path / "picture.tif")[..., 3]
    assert np.mean(alpha == 255) == pytest.approx(drawn["valid"])


def test_points_and_meshes_of_a_part_lie_in_the_part(ask, tmp_path, figures_of):
    corners = np.array([200, 80, 320, 190])
    figures_of(
        *ask("analyze", "-o", tmp_path / "part.npz", "--roi", *corners),
        "--ply",
        tmp_path / "part.ply",
    )
    depth = lfrender.DepthMap.load(tmp_path / "part.npz")
    header, _, data = (tmp_path / "part.ply").read_bytes().partition(b"end_header\n")
    points = np.frombuffer(data, [("at", "<f4", 3), ("colour", "u1", 3)])
    low, high = np.sort(corners.reshape(2, 2), axis=0) / depth.pitch
    assert f"element vertex {len(points)}".encode() in header and len(points) > 100
    assert (points["at"][:, :2] > low - 1).all() and (points["at"][:, :2] < high + 1).all()


def test_opposite_corners_of_a_region_come_in_any_order(
    ask, tmp_path, run, figures_of, assert_refused
):
    pictures = []
    for corners in ((100, 80, 220, 190), (220, 190, 100, 80), (100, 190, 220, 80)):
        figures_of(*ask("render", "--roi", *corners, "--patch-size", "6", "-o", tmp_path / "p.png"))
        pictures.append(lfcal.read_flat(tmp_path / "p.png"))
    assert np.array_equal(pictures[0], pictures[1]) and np.array_equal(pictures[0], pictures[2])
    for command, out in (("render", "o.png"), ("analyze", "o.npz")):
        words = ask(command, "-o", tmp_path / out, "--roi")
        assert_refused(run(*words, 900, 800, 600, 700), "roi 900 800 600 700 lies outside", "420")
        assert_refused(run(*words, 40, 80, 40, 190), "--roi 40 80 40 190 has no area")
        assert_refused(
            run(*words, 40, 80, 90, "--quiet"), "'--roi'", "'--quiet' is not a valid float"
        )


def test_the_suffix_decides_in_which_form_depth_is_written(
    ask, tmp_path, run, figures_of, assert_refused
):
    for name in ("depth.tif", "depth.png", "cloud.ply", "scene.glb"):
        figures_of(*ask("analyze", "--preset", "fast", "-o", tmp_path / name))
    assert sorted(os.listdir(tmp_path)) == ["cloud.ply", "depth.png", "depth.tif", "scene.glb"]
    twice = ask("analyze", "-o", tmp_path / "a.tif", "--dense", tmp_path / "b.tif")
    assert_refused(run(*twice), "--output and --dense exclude each other")
    assert tifffile.imread(tmp_path / "depth.tif").dtype == np.float32
    assert lfcal.read_flat(tmp_path / "depth.png").ndim == 3
    figures_of(
        *ask(
            "analyze",
            "-o",
            tmp_path / "d.npz",
            "--preset",
            "fast",
            "--dense",
            tmp_path / "d.pfm",
            "--unfilled",
        )
    )
    assert 0 < np.isnan(cv2.imread(str(tmp_path / "d.pfm"), cv2.IMREAD_UNCHANGED)).mean() < 0.9
    assert_refused(run(*ask("analyze", "-o", tmp_path / "d.npz", "--unfilled")), "--dense")


def test_the_suffix_decides_whether_views_and_focus_move(ask, tmp_path, run, assert_refused):
    for command in ("views", "refocus"):
        assert run(*ask(command, "--scale", "2", "-o", tmp_path / f"{command}.gif")).exit_code == 0
        with Image.open(tmp_path / f"{command}.gif") as moving:
            assert moving.n_frames == (24 if command == "views" else 46)  # there, and back again
    if pytest.importorskip("av"):
        assert (
            run(
                *ask("refocus", "--scale", "2", "--stack", "3", "-o", tmp_path / "focus.mp4")
            ).exit_code
            == 0
        )
    assert_refused(
        run(*ask("views", "-o", tmp_path / "v.png")), "--stereo, --animation N or --quilt"
    )
    assert run(*ask("views", "--scale", "2", "-o", tmp_path / "v.webp")).exit_code == 0
    with Image.open(tmp_path / "v.webp") as moving:
        assert moving.n_frames == 24
    assert_refused(run(*ask("refocus", "--at", 9, 9, "-o", tmp_path / "f.gif")), "several depths")
    quilt = run(*ask("views", "--quilt", "3x2", "--scale", "3", "-o", tmp_path / "quilt.png"))
    assert quilt.exit_code == 0 and (tmp_path / "quilt.png").exists()


def test_a_mosaic_flat_is_rendered_in_colour_when_its_filters_are_named(
    ask, house_files, raw_house, tmp_path, run, figures_of, assert_refused
):
    camera = ("-c", house_files / "camera.json")
    raw = ("render", raw_house, *camera, "--mosaic", "RGGB", "--white-balance", "none")
    figures_of(*raw, "-o", tmp_path / "picture.png")
    figures_of(*ask("render", "-o", tmp_path / "wanted.png"))
    picture, wanted = (lfcal.read_flat(tmp_path / f"{name}.png") for name in ("picture", "wanted"))
    inner = np.s_[10:-10, 10:-10]
    np.testing.assert_allclose(picture[inner].mean((0, 1)), wanted[inner].mean((0, 1)), rtol=0.02)
    assert_refused(
        run(*ask("render", "--mosaic", "RGGB", "-o", tmp_path / "refused.png")), "in colour already"
    )
