"""The lfrender command: whole chains, the figures it prints, and how it refuses."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from PIL import Image, ImageCms

import lfcal
from lfrender.cli.main import main


def run(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)


def figures_of(*arguments):
    result = run(*arguments, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def assert_refused(result, *words):
    assert result.exit_code == 2, result.output
    assert result.stderr.count("\n") == 1
    for word in words:
        assert word in result.stderr


def test_analyze_then_render_with_its_depth(house_files, tmp_path):
    flat, camera = house_files / "flat.png", house_files / "camera.json"
    analysed = figures_of("analyze", flat, "-c", camera, "-o", tmp_path / "depth.npz", "--preset", "fast")
    assert analysed["modes"]["telescopic"] > 0.3
    assert analysed["modes"]["binocular"] > 0.1
    assert sum(analysed["modes"].values()) == pytest.approx(1)
    drawn = figures_of("render", flat, "-c", camera, "--depth", tmp_path / "depth.npz", "-o", tmp_path / "picture.tif")
    assert set(drawn["seconds"]) == {"read", "calibrate", "analyze", "render", "write"}
    picture = lfcal.read_flat(tmp_path / "picture.tif")
    assert list(picture.shape[1::-1]) == drawn["size"]
    assert picture.dtype == np.uint8
    assert picture.std() > 20
    with tifffile.TiffFile(tmp_path / "picture.tif") as tiff:
        description = json.loads(tiff.pages[0].description)
    assert description["affine"] == drawn["affine"]
    assert (description["rendering"], description["preset"]) == ("all in focus", "fast")
    assert sorted(os.listdir(tmp_path)) == ["depth.npz", "picture.tif"]


def test_render_without_a_depth_file_gives_the_same_picture(house_files, tmp_path):
    flat, camera = house_files / "flat.png", house_files / "camera.json"
    figures_of("analyze", flat, "-c", camera, "-o", tmp_path / "depth.npz")
    figures_of("render", flat, "-c", camera, "--depth", tmp_path / "depth.npz", "-o", tmp_path / "two.png")
    figures_of("render", flat, "-c", camera, "-o", tmp_path / "one.png")
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "one.png"), lfcal.read_flat(tmp_path / "two.png"))


def test_render_writes_ome_zarr_where_the_name_says_so(house_files, tmp_path):
    zarr = pytest.importorskip("zarr", minversion="3.0", reason="Zarr needs lfrender[zarr]")
    ask = ("render", house_files / "flat.png", "-c", house_files / "camera.json", "--patch-size", -5)
    figures_of(*ask, "-o", tmp_path / "a.ome.zarr")
    assert "multiscales" in dict(zarr.open_group(str(tmp_path / "a.ome.zarr"), mode="r").attrs)["ome"]
    figures_of(*ask, "-o", tmp_path / "a.zarr")
    assert zarr.open_array(str(tmp_path / "a.zarr"), mode="r").ndim == 3


def test_render_calibrates_from_the_flat_or_a_white_image(house, house_files, tmp_path):
    flat = house_files / "flat.png"
    for options, source in [((), "scene"), (("--white", house_files / "white.png"), "white")]:
        drawn = figures_of("render", flat, *options, "-o", tmp_path / "picture.png")
        assert drawn["camera_source"] == source
        assert drawn["pitch"] == pytest.approx(house.camera.pitch, abs=0.1)


def test_a_flat_in_which_no_lens_has_a_depth_is_warned_about(house_files, tmp_path):
    found = figures_of(
        "analyze", house_files / "white.png", "-c", house_files / "camera.json", "-o", tmp_path / "d.npz"
    )
    assert found["modes"]["unresolved"] > 0.95
    assert "is this a capture of a scene" in found["warnings"][-1]
    roi = ("--roi", 200, 150, 260, 210)
    part = figures_of(
        "analyze", house_files / "flat.png", *roi, "-c", house_files / "camera.json", "-o", tmp_path / "p.npz"
    )
    assert part["modes"]["unresolved"] > 0.95
    assert part["warnings"] == []


def test_depth_needs_nothing_but_the_flat(house_files, tmp_path):
    flat = house_files / "flat.png"
    found = figures_of("analyze", flat, "-o", tmp_path / "depth.npz", "--preset", "fast")
    assert found["camera_source"] == "scene"
    assert found["modes"]["telescopic"] > 0.3
    assert_refused(
        run("analyze", flat, "-c", "a.json", "--white", "b.png", "-o", tmp_path / "d.npz"), "exclude each other"
    )


def test_scale_is_the_number_of_pixels_per_pitch(house, house_files, tmp_path):
    flat, camera = house_files / "flat.png", house_files / "camera.json"
    drawn = figures_of(
        "render", flat, "-c", camera, "--patch-size", "5", "--scale", "10", "-o", tmp_path / "picture.png"
    )
    assert drawn["scale"] == pytest.approx(10)
    width, height = house.camera.width, house.camera.height
    assert drawn["size"] == pytest.approx([width / house.camera.pitch * 10, height / house.camera.pitch * 10], rel=0.1)


def test_traditional_picture_has_one_pixel_per_lens(house, house_files, tmp_path):
    drawn = figures_of(
        "render", house_files / "flat.png", "-c", house_files / "camera.json", "--traditional", "-o", tmp_path / "t.png"
    )
    assert drawn["scale"] == pytest.approx(1, rel=0.1)
    assert np.prod(drawn["size"]) == pytest.approx(len(house.truth.mode), rel=0.35)


def test_refocus_draws_one_depth_and_blend_is_its_mean_over_lenses(house_files, tmp_path):
    flat, camera = house_files / "flat.png", house_files / "camera.json"
    refocused = figures_of("refocus", flat, "-c", camera, "-o", tmp_path / "a.tif", "--patch-size", 6)
    assert refocused["scale"] == 6
    for name, options in (("crisp.tif", []), ("blend.tif", ["--blend"])):
        figures_of("render", flat, "-c", camera, "-o", tmp_path / name, "--patch-size", 6, *options)
    picture, crisp, blend = (tifffile.imread(tmp_path / name) for name in ("a.tif", "crisp.tif", "blend.tif"))
    # Mixing lenses that see a place out of focus takes detail from the picture.
    detail = [np.abs(np.diff(image.astype(float), axis=1)).mean() for image in (picture, blend, crisp)]
    assert detail[0] < 0.95 * detail[1] < 0.9 * detail[2]
    assert_refused(run("refocus", flat, "-c", camera, "-o", tmp_path / "b.tif"), "--patch-size, --at and --stack")
    assert_refused(run("render", flat, "-c", camera, "-o", tmp_path / "b.tif", "--blend"), "--blend needs")


def test_a_focal_stack_is_written_from_far_to_near_with_the_profile_of_the_flat(house_files, tmp_path):
    camera, profile = house_files / "camera.json", ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    flat, depth = tmp_path / "flat.png", tmp_path / "depth.npz"
    with Image.open(house_files / "flat.png") as image:
        image.save(flat, icc_profile=profile)
    figures_of("analyze", flat, "-c", camera, "-o", depth, "--preset", "fast")
    common = ["refocus", flat, "-c", camera, "--depth", depth, "--scale", 5]
    found = figures_of(*common, "-o", tmp_path / "stack.tif", "--stack", 4)
    ratios = 1 / np.array(found["patch_sizes"])
    # The house has a telescopic background and binocular branches in front of it.
    assert ratios[0] > 0 > ratios[-1] and (np.diff(ratios) < 0).all()
    with tifffile.TiffFile(tmp_path / "stack.tif") as tiff:
        assert len(tiff.pages) == 4
        assert [json.loads(page.description)["patch_size"] for page in tiff.pages] == found["patch_sizes"]
        assert bytes(tiff.pages[3].tags[34675].value) == profile
        pages = tiff.asarray()
    sizes = [word for size in found["patch_sizes"][:2] for word in ("--patch-size", size)]
    given = figures_of(*common, "-o", tmp_path / "s.png", *sizes)
    assert given["pictures"] == [str(tmp_path / "s_01.png"), str(tmp_path / "s_02.png")]
    for path, page in zip(given["pictures"], pages, strict=False):
        with Image.open(path) as image:
            np.testing.assert_array_equal(np.asarray(image), page)
    at = figures_of(*common, "-o", tmp_path / "at.png", "--at", 200, 150)
    assert at["picture"] == str(tmp_path / "at.png")
    assert_refused(run(*common, "-o", tmp_path / "b.tif", "--at", 200, 150, "--stack", 3), "exclude each other")


def test_alpha_marks_the_pixels_nothing_has_seen(house_files, tmp_path):
    flat, camera = house_files / "flat.png", house_files / "camera.json"
    drawn = figures_of("render", flat, "-c", camera, "--patch-size", "-6", "--alpha", "-o", tmp_path / "picture.tif")
    alpha = tifffile.imread(tmp_path / "picture.tif")[..., 3]
    assert np.mean(alpha == 255) == pytest.approx(drawn["valid"])


@pytest.mark.parametrize(
    "options",
    [
        ("--traditional", "--patch-size", "5"),
        ("--traditional", "--depth", "depth.npz"),
        ("--traditional", "--scale", "4"),
        ("--camera", "a.json", "--white", "b.png"),
        ("--scale", "0"),
        ("--scale", "-3"),
        ("--patch-size", "much"),
        ("--preset", "best"),
    ],
)
def test_options_that_make_no_sense_are_one_line(house_files, tmp_path, options):
    assert_refused(run("render", house_files / "flat.png", *options, "-o", tmp_path / "picture.png"))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("scale", ["nan", "inf", "1e9"])
def test_impossible_scales_and_patch_sizes_are_refused(house_files, tmp_path, scale):
    flat, camera = house_files / "flat.png", house_files / "camera.json"
    assert_refused(run("render", flat, "-c", camera, "--patch-size", "5", "--scale", scale, "-o", tmp_path / "p.png"))
    if scale != "1e9":
        assert_refused(run("render", flat, "-c", camera, "--patch-size", scale, "-o", tmp_path / "p.png"))
    assert os.listdir(tmp_path) == []


def test_camera_of_another_image_size_is_refused(house, house_files, tmp_path):
    cv2.imwrite(str(tmp_path / "part.png"), house.flat[:-10, :-20])
    for command in (("analyze", "-o", tmp_path / "d.npz"), ("render", "-o", tmp_path / "p.png")):
        arguments = (command[0], tmp_path / "part.png", "-c", house_files / "camera.json", *command[1:])
        assert_refused(run(*arguments), "520 x 400", "500 x 390")
    assert_refused(
        run("render", tmp_path / "part.png", "--white", house_files / "white.png", "-o", tmp_path / "p.png"), "one size"
    )
    assert os.listdir(tmp_path) == ["part.png"]


@pytest.mark.parametrize("command", ["render", "analyze"])
def test_a_camera_is_checked_against_the_flat_before_that_is_analysed(command, house, house_files, tmp_path):
    camera, flat = house.truth.calibration, house_files / "flat.png"
    lattice = camera.lattice
    replace(camera, lattice=replace(lattice, origin=lattice.origin + np.array([4, 3]))).save(tmp_path / "moved.json")
    replace(camera, lattice=replace(lattice, basis=1.3 * lattice.basis)).save(tmp_path / "other.json")
    output = tmp_path / ("depth.npz" if command == "analyze" else "picture.png")
    moved = run(command, flat, "-c", tmp_path / "moved.json", "-o", output, "--preset", "fast")
    assert moved.exit_code == 0
    assert "warning: the microimages lie 5.0 px beside those of the camera" in moved.stderr
    output.unlink()
    assert_refused(
        run(command, flat, "-c", tmp_path / "other.json", "-o", output, "--preset", "fast"),
        "other.json", "not made with this camera",
    )  # fmt: skip
    assert not output.exists()


def test_depth_of_another_camera_or_no_depth_at_all_is_refused(house, house_files, tmp_path):
    flat, camera = house_files / "flat.png", house_files / "camera.json"
    (tmp_path / "text.npz").write_text("no depth")
    (tmp_path / "empty.npz").touch()
    for name in ("text.npz", "empty.npz", "missing.npz", ""):
        assert_refused(run("render", flat, "-c", camera, "--depth", tmp_path / name, "-o", tmp_path / "p.png"))
    figures_of("analyze", flat, "-c", camera, "-o", tmp_path / "depth.npz", "--preset", "fast")
    cv2.imwrite(str(tmp_path / "part.png"), house.flat[:-10, :-20])
    lattice = house.truth.calibration.lattice
    part = lfcal.Calibration(lfcal.Lattice(lattice.origin, lattice.basis, (500, 390), lattice.radius))
    part.save(tmp_path / "part.json")
    assert_refused(
        run(
            "render", tmp_path / "part.png", "-c", tmp_path / "part.json",
            "--depth", tmp_path / "depth.npz", "-o", tmp_path / "p.png",
        )
    )  # fmt: skip
    assert not (tmp_path / "p.png").exists()


@pytest.mark.parametrize("name", ["missing.png", "empty.png", "truncated.png", "text.png", "nan.tif", "tiny.png", ""])
def test_bad_flats_are_one_line_and_leave_no_file(house, house_files, tmp_path, name):
    data = (house_files / "flat.png").read_bytes()
    (tmp_path / "empty.png").touch()
    (tmp_path / "truncated.png").write_bytes(data[: len(data) // 2])
    (tmp_path / "text.png").write_text("no picture\n")
    tifffile.imwrite(tmp_path / "nan.tif", np.full(house.flat.shape, np.inf, np.float32), photometric="rgb")
    cv2.imwrite(str(tmp_path / "tiny.png"), house.flat[:40, :40])
    before = sorted(os.listdir(tmp_path))
    assert_refused(run("render", tmp_path / name, "-o", tmp_path / "picture.png"))
    assert_refused(run("analyze", tmp_path / name, "-c", house_files / "camera.json", "-o", tmp_path / "depth.npz"))
    assert sorted(os.listdir(tmp_path)) == before


def test_bad_outputs_are_refused_before_the_flat_is_read(tmp_path):
    for output in ("picture.gif", "picture", "nowhere/picture.png", "."):
        assert_refused(run("render", tmp_path / "missing.png", "-o", tmp_path / output))
        assert_refused(run("analyze", tmp_path / "missing.png", "-c", "c.json", "-o", tmp_path / output))
    assert_refused(run("render", tmp_path / "missing.png", "--alpha", "-o", tmp_path / "picture.jpg"), "alpha")


def test_inputs_are_never_replaced(house, tmp_path):
    for name in ("flat.png", "white.png"):
        cv2.imwrite(str(tmp_path / name), house.flat)
    before = (tmp_path / "flat.png").read_bytes()
    os.symlink(tmp_path / "flat.png", tmp_path / "link.png")
    for output in ("flat.png", "white.png", "link.png"):
        assert_refused(
            run("render", tmp_path / "flat.png", "--white", tmp_path / "white.png", "-o", tmp_path / output), "input"
        )
    assert (tmp_path / "flat.png").read_bytes() == before


def test_sixteen_bits_become_eight_where_the_format_or_the_user_wants_it_and_that_is_said(house_files, tmp_path):
    flat, camera = lfcal.read_flat(house_files / "flat.png"), house_files / "camera.json"
    tifffile.imwrite(tmp_path / "flat.tif", flat.astype(np.uint16) * 257, photometric="rgb")
    ask = ("render", tmp_path / "flat.tif", "-c", camera, "--patch-size", "6")
    pictures = {}
    for name, options in (("a.jpg", ()), ("b.png", ("--8bit",)), ("c.png", ())):
        result = run(*ask, "-o", tmp_path / name, *options)
        assert result.exit_code == 0, result.output
        assert ("8 bits: 0 to 65535 became 0 to 255 in proportion" in result.stdout) == (name != "c.png")
        pictures[name] = lfcal.read_flat(tmp_path / name)
    assert [picture.dtype for picture in pictures.values()] == [np.uint8, np.uint8, np.uint16]
    assert np.abs(pictures["b.png"] - pictures["c.png"] / 257).max() <= 0.5
    assert np.abs(pictures["a.jpg"].astype(float) - pictures["b.png"]).mean() < 6  # grey levels: JPEG


def test_a_command_ends_with_sentences_and_percentages(house_files, tmp_path):
    flat, camera = house_files / "flat.png", house_files / "camera.json"
    lines = run("render", flat, "-c", camera, "-o", tmp_path / "picture.png").stdout.splitlines()
    assert [line for line in lines if not line.startswith("compiling")] == lines[-3:]
    assert lines[-3] == "588 microlenses, 20.3 px apart, as the camera file says."
    assert re.fullmatch(r"Of the lenses \d+ % telescopic, \d+ % binocular, \d+(\.\d)? % unresolved\.", lines[-2])
    size = "{1} x {0}".format(*lfcal.read_flat(tmp_path / "picture.png").shape)
    assert lines[-1].startswith(f"{tmp_path / 'picture.png'}: {size} px, sharp at every depth, in ")


def test_opposite_corners_of_a_region_come_in_any_order(house_files, tmp_path):
    flat, camera = house_files / "flat.png", house_files / "camera.json"
    ask = ("-c", camera, "--patch-size", "6", "-o")
    pictures = []
    for corners in ((100, 80, 220, 190), (220, 190, 100, 80), (100, 190, 220, 80)):
        figures_of("render", flat, "--roi", *corners, *ask, tmp_path / "p.png")
        pictures.append(lfcal.read_flat(tmp_path / "p.png"))
    assert np.array_equal(pictures[0], pictures[1]) and np.array_equal(pictures[0], pictures[2])
    for command in (("render", flat, *ask[:2]), ("analyze", flat, *ask[:2])):
        out = tmp_path / ("o.png" if command[0] == "render" else "o.npz")
        assert_refused(run(*command, "--roi", 900, 800, 600, 700, "-o", out), "roi 900 800 600 700 lies outside", "520")
        assert_refused(run(*command, "--roi", 40, 80, 40, 190, "-o", out), "--roi 40 80 40 190 has no area")
        assert_refused(run(*command, "--roi", 40, 80, 90, "-o", out), "give four numbers", "'-o' is none")


def test_the_suffix_decides_in_which_form_depth_is_written(house_files, tmp_path):
    ask = ("analyze", house_files / "flat.png", "-c", house_files / "camera.json", "--preset", "fast", "-o")
    for name in ("depth.tif", "depth.png", "cloud.ply"):
        figures_of(*ask, tmp_path / name)
    assert sorted(os.listdir(tmp_path)) == ["cloud.ply", "depth.png", "depth.tif"]
    assert tifffile.imread(tmp_path / "depth.tif").dtype == np.float32
    assert lfcal.read_flat(tmp_path / "depth.png").ndim == 3


def test_the_suffix_decides_whether_views_and_focus_move(house_files, tmp_path):
    flat, camera = house_files / "flat.png", house_files / "camera.json"
    common = ("-c", camera, "--scale", "2")
    for command in ("views", "refocus"):
        assert run(command, flat, *common, "-o", tmp_path / f"{command}.gif").exit_code == 0
        with Image.open(tmp_path / f"{command}.gif") as moving:
            assert moving.n_frames == (24 if command == "views" else 46)  # there, and back again
    assert run("refocus", flat, *common, "--stack", "3", "-o", tmp_path / "focus.mp4").exit_code == 0
    assert_refused(run("views", flat, *common, "-o", tmp_path / "v.png"), "--stereo, --animation N or --quilt")
    assert_refused(run("refocus", flat, *common, "--at", 9, 9, "-o", tmp_path / "f.gif"), "several depths")


def test_folders_are_not_made_under_the_name_of_a_file(house_files, tmp_path):
    flat, camera = house_files / "flat.png", house_files / "camera.json"
    assert_refused(run("views", flat, "-c", camera, "-o", tmp_path / "v.glb"), "v.glb", "'.glb'")
    assert_refused(run("batch", flat, "-c", camera, "-o", tmp_path / "bt.jpg"), "bt.jpg", "'.jpg'")
    assert os.listdir(tmp_path) == []


def test_dense_depth_has_no_values_where_none_are_wanted(house_files, tmp_path):
    ask = ("analyze", house_files / "flat.png", "-c", house_files / "camera.json", "-o", tmp_path / "d.npz")
    figures_of(*ask, "--preset", "fast", "--dense", tmp_path / "d.pfm", "--unfilled")
    assert 0 < np.isnan(cv2.imread(str(tmp_path / "d.pfm"), cv2.IMREAD_UNCHANGED)).mean() < 0.9
    assert_refused(run(*ask, "--unfilled"), "--dense")


def test_a_folder_in_the_place_of_a_flat_points_to_batch(house_files, tmp_path):
    refused = run("render", house_files, "-o", tmp_path / "p.png")
    assert_refused(refused, f"{house_files} is a folder", f"'lfrender batch {house_files} -o pictures'")


def test_flats_come_from_pipes_and_pictures_go_into_them(house_files, tmp_path):
    ask = ["-c", str(house_files / "camera.json"), "--patch-size", "6", "-o"]
    data = (house_files / "flat.png").read_bytes()
    piped = CliRunner().invoke(main, ["render", "-", *ask, "-"], input=data)
    assert piped.exit_code == 0, piped.stderr
    run("render", house_files / "flat.png", *ask, tmp_path / "p.png")
    (tmp_path / "piped.png").write_bytes(piped.stdout_bytes)
    assert np.array_equal(lfcal.read_flat(tmp_path / "piped.png"), lfcal.read_flat(tmp_path / "p.png"))
    assert "\nstdout: " in piped.stderr
    named = CliRunner().invoke(main, ["render", "-", *ask, "-.tif"], input=data)
    assert named.stdout_bytes[:2] in (b"II", b"MM")
    assert_refused(CliRunner().invoke(main, ["render", "-", *ask, "-"], input=b""), "nothing came")


def test_published_calibrations_are_accepted(shared, tmp_path):
    flat = shared("captures", "Fujita2.png")
    for name in ("Fujita2.published.xml", "Fujita2.published.cfg"):
        camera = shared("captures", name)
        drawn = figures_of("render", flat, "-c", camera, "--patch-size", "-7", "-o", tmp_path / "picture.tif")
        assert drawn["camera_source"] == "published"
        assert drawn["pitch"] == pytest.approx(23.2, abs=0.3)


def test_help_imports_nothing_heavy():
    code = (
        "import sys\nfrom lfrender.cli.main import main\n"
        "try: main(['render', '--help'])\nexcept SystemExit as end: assert end.code == 0\n"
        "print([m for m in ('numba', 'scipy', 'cv2', 'PIL', 'tifffile', 'skimage', 'rich') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip().endswith("[]")


@pytest.fixture
def raw_house(house_files, tmp_path):
    """The flat of the house seen through filters RGGB."""
    colour = lfcal.read_flat(house_files / "flat.png")
    raw = colour[:, :, 1].copy()
    raw[::2, ::2], raw[1::2, 1::2] = colour[::2, ::2, 0], colour[1::2, 1::2, 2]
    cv2.imwrite(str(tmp_path / "raw.png"), raw)
    return tmp_path / "raw.png"


@pytest.mark.parametrize(
    "command, source",
    [("render", "-c"), ("render", "--white"), ("views", "-c"), ("batch", "-c"), ("batch", "--white"), ("batch", "")],
)
def test_colour_filters_that_nobody_named_are_found_on_the_flat_and_said_to_be_a_guess(
    house_files, raw_house, tmp_path, command, source
):
    camera = house_files / ("camera.json" if source == "-c" else "white.png")
    output = tmp_path / ("out" if command == "batch" else "out.png")
    more = [source, camera] if source else []
    more += {"views": ["--stereo"], "batch": ["--format", "png"]}.get(command, [])
    result = run(command, raw_house, "-o", output, *more)
    assert result.exit_code == 0, result.stderr
    assert "red and blue are a guess" in result.stderr
    pictures = sorted(path for path in tmp_path.rglob("*.png") if path != raw_house)
    assert pictures and all(lfcal.read_flat(path).ndim == 3 for path in pictures)


def test_a_mosaic_flat_is_rendered_in_colour_when_its_filters_are_named(house_files, raw_house, tmp_path):
    camera = house_files / "camera.json"
    figures_of("render", tmp_path / "raw.png", "-c", camera, "--mosaic", "RGGB", "-o", tmp_path / "picture.png")
    figures_of("render", house_files / "flat.png", "-c", camera, "-o", tmp_path / "wanted.png")
    picture, wanted = (lfcal.read_flat(tmp_path / f"{name}.png") for name in ("picture", "wanted"))
    inner = np.s_[10:-10, 10:-10]
    np.testing.assert_allclose(picture[inner].mean((0, 1)), wanted[inner].mean((0, 1)), rtol=0.02)
    refused = run("render", house_files / "flat.png", "-c", camera, "--mosaic", "RGGB", "-o", tmp_path / "refused.png")
    assert refused.exit_code == 2
    assert "in colour already" in refused.stderr


def test_a_camera_that_was_measured_on_a_scene_is_that_of_its_file(house_files, tmp_path):
    flat, camera = house_files / "flat.png", tmp_path / "scene.json"
    replace(lfcal.load(house_files / "camera.json"), source="scene", confidence=0.98).save(camera)
    told = run("render", flat, "-c", camera, "--traditional", "-o", tmp_path / "t.png").stdout
    assert "as the camera file says." in told and "found on the flat" not in told


def test_batch_says_what_is_doubtful_about_its_camera(house, house_files, tmp_path):
    lattice = house.truth.calibration.lattice
    moved = replace(house.truth.calibration, lattice=replace(lattice, origin=lattice.origin + np.array([4, 3])))
    moved.save(tmp_path / "moved.json")
    ask = ("batch", house_files / "flat.png", "-c", tmp_path / "moved.json", "-o", tmp_path / "out", "--preset", "fast")
    assert "warning: the microimages lie 5.0 px beside" in run(*ask).stderr
    assert "5.0 px beside" in figures_of(*ask)["warnings"][0]
