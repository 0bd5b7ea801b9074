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
    return CliRunner().invoke(
        main, [str(argument) for argument in arguments], catch_exceptions=False
    )


def figures_of(*arguments):
    result = run(*arguments, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def assert_refused(result, *words):
    assert result.exit_code == 2, result.output
    assert result.stderr.count("\n") == 1
    assert all(word in result.stderr for word in words), result.stderr


@pytest.fixture
def ask(house_files):
    """The words of a command on the flat of the house, with its camera."""
    return lambda command, *more: (
        command,
        house_files / "flat.png",
        "-c",
        house_files / "camera.json",
        *more,
    )


@pytest.fixture
def moved(house, tmp_path):
    """A camera file whose centres lie 5 px beside those of the flat."""
    camera = house.truth.calibration
    lattice = replace(camera.lattice, origin=camera.lattice.origin + np.array([4, 3]))
    replace(camera, lattice=lattice).save(tmp_path / "moved.json")
    return tmp_path / "moved.json"


def test_analyze_then_render_with_its_depth_or_without_gives_the_same_picture(ask, tmp_path):
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


def test_render_writes_ome_zarr_where_the_name_says_so(ask, tmp_path):
    zarr = pytest.importorskip("zarr", minversion="3.0", reason="Zarr needs lfrender[zarr]")
    figures_of(*ask("render", "--patch-size", -5, "-o", tmp_path / "a.ome.zarr"))
    assert (
        "multiscales" in dict(zarr.open_group(str(tmp_path / "a.ome.zarr"), mode="r").attrs)["ome"]
    )
    figures_of(*ask("render", "--patch-size", -5, "-o", tmp_path / "a.zarr"))
    assert zarr.open_array(str(tmp_path / "a.zarr"), mode="r").ndim == 3


def test_render_calibrates_from_the_flat_or_a_white_image(house, house_files, tmp_path):
    for options, source in [((), "scene"), (("--white", house_files / "white.png"), "white")]:
        drawn = figures_of(
            "render", house_files / "flat.png", *options, "-o", tmp_path / "picture.png"
        )
        assert drawn["camera_source"] == source
        assert drawn["pitch"] == pytest.approx(house.camera.pitch, abs=0.1)


def test_a_flat_in_which_no_lens_has_a_depth_is_warned_about(ask, house_files, tmp_path):
    _, _, *camera = ask("analyze")
    found = figures_of("analyze", house_files / "white.png", *camera, "-o", tmp_path / "d.npz")
    assert found["modes"]["unresolved"] > 0.95
    assert "is this a capture of a scene" in found["warnings"][-1]
    part = figures_of(*ask("analyze", "--roi", 200, 150, 260, 210, "-o", tmp_path / "p.npz"))
    # Shares are those of the lenses of the part.
    assert part["lenses_analysed"] < 0.2 * part["lenses"] and part["modes"]["unresolved"] < 0.9
    assert part["warnings"] == []
    white = run("render", house_files / "white.png", "--traditional", "-o", tmp_path / "x.png")
    assert white.exit_code == 0 and "this is a white image" in white.stderr


def test_scale_is_the_number_of_pixels_per_pitch(house, ask, tmp_path):
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


def test_refocus_draws_one_depth_and_blend_is_its_mean_over_lenses(ask, tmp_path):
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
    house_files, tmp_path
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


def test_alpha_marks_the_pixels_nothing_has_seen(ask, tmp_path):
    drawn = figures_of(
        *ask("render", "--patch-size", "-6", "--alpha", "-o", tmp_path / "picture.tif")
    )
    alpha = tifffile.imread(tmp_path / "picture.tif")[..., 3]
    assert np.mean(alpha == 255) == pytest.approx(drawn["valid"])


@pytest.mark.parametrize(
    "words",
    [
        "--traditional --patch-size 5",
        "--scale 0",
        "--patch-size much",
        "--preset best",
        "--patch-size 5 --scale nan",
        "--patch-size 5 --scale 1e9",
        "--patch-size 0",
    ],
)
def test_options_that_make_no_sense_are_one_line(ask, tmp_path, words):
    assert_refused(run(*ask("render", *words.split(), "-o", tmp_path / "picture.png")))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("command", ["render", "analyze"])
def test_a_camera_is_checked_against_the_flat_before_that_is_analysed(
    command, house, house_files, moved, tmp_path
):
    camera = house.truth.calibration
    flat = house_files / "flat.png"
    replace(camera, lattice=replace(camera.lattice, basis=1.3 * camera.lattice.basis)).save(
        tmp_path / "other.json"
    )
    cv2.imwrite(str(tmp_path / "part.png"), house.flat[:-10, :-20])
    output = tmp_path / ("depth.npz" if command == "analyze" else "picture.png")
    told = run(command, flat, "-c", moved, "-o", output, "--preset", "fast")
    assert told.exit_code == 0
    assert "warning: the microimages lie 5.0 px beside those of the camera" in told.stderr
    output.unlink()
    other = run(command, flat, "-c", tmp_path / "other.json", "-o", output, "--preset", "fast")
    assert_refused(other, "other.json", "not made with this camera")
    part = run(command, tmp_path / "part.png", "-c", house_files / "camera.json", "-o", output)
    assert_refused(part, "420 x 330", "400 x 320")
    white = run(command, tmp_path / "part.png", "--white", house_files / "white.png", "-o", output)
    assert_refused(white, "one size")
    both = run(command, flat, "-c", moved, "--white", house_files / "white.png", "-o", output)
    assert_refused(both, "exclude each other")
    assert not output.exists()


def test_depth_of_another_camera_or_no_depth_at_all_is_refused(house, ask, tmp_path):
    (tmp_path / "text.npz").write_text("no depth")
    (tmp_path / "empty.npz").touch()
    (tmp_path / "depth.json").touch()
    for name in ("text.npz", "empty.npz", "missing.npz", "depth.json", ""):
        assert_refused(run(*ask("render", "--depth", tmp_path / name, "-o", tmp_path / "p.png")))
    figures_of(*ask("analyze", "-o", tmp_path / "depth.npz", "--preset", "fast"))
    cv2.imwrite(str(tmp_path / "part.png"), house.flat[:-10, :-20])
    lattice = house.truth.calibration.lattice
    lfcal.Calibration(replace(lattice, image_size=(400, 320))).save(tmp_path / "part.json")
    words = (
        "-c",
        tmp_path / "part.json",
        "--depth",
        tmp_path / "depth.npz",
        "-o",
        tmp_path / "p.png",
    )
    assert_refused(run("render", tmp_path / "part.png", *words))
    assert not (tmp_path / "p.png").exists()


@pytest.mark.parametrize(
    "name", ["missing.png", "empty.png", "truncated.png", "nan.tif", "tiny.png"]
)
def test_bad_flats_are_one_line_and_leave_no_file(house, house_files, tmp_path, name):
    data = (house_files / "flat.png").read_bytes()
    (tmp_path / "empty.png").touch()
    (tmp_path / "truncated.png").write_bytes(data[: len(data) // 2])
    tifffile.imwrite(
        tmp_path / "nan.tif", np.full(house.flat.shape, np.inf, np.float32), photometric="rgb"
    )
    cv2.imwrite(str(tmp_path / "tiny.png"), house.flat[:40, :40])
    before = sorted(os.listdir(tmp_path))
    assert_refused(run("render", tmp_path / name, "-o", tmp_path / "picture.png"))
    assert_refused(
        run(
            "analyze",
            tmp_path / name,
            "-c",
            house_files / "camera.json",
            "-o",
            tmp_path / "depth.npz",
        )
    )
    assert sorted(os.listdir(tmp_path)) == before


@pytest.mark.parametrize(
    "command", ["render", "analyze", "refocus", "views", "view", "report", "batch"]
)
def test_outputs_of_a_suffix_that_a_command_does_not_write_are_refused_by_all_alike(
    ask, tmp_path, command
):
    more = ("--patch-size", "6") if command == "refocus" else ()
    output = ("--export" if command == "view" else "-o", tmp_path / "scene.obj")
    assert_refused(run(*ask(command, *more, *output)), "scene.obj: unknown output format '.obj'; ")
    if command not in ("views", "view", "batch"):
        assert_refused(run(*ask(command, *more, "-o", tmp_path / "no" / "scene.tif")))
    assert os.listdir(tmp_path) == []


def test_inputs_are_never_replaced(house, tmp_path):
    for name in ("flat.png", "white.png"):
        cv2.imwrite(str(tmp_path / name), house.flat)
    before = (tmp_path / "flat.png").read_bytes()
    os.symlink(tmp_path / "flat.png", tmp_path / "link.png")
    for output in ("flat.png", "white.png", "link.png"):
        words = ("--white", tmp_path / "white.png", "-o", tmp_path / output)
        assert_refused(run("render", tmp_path / "flat.png", *words), "input")
    assert_refused(
        run("render", tmp_path / "flat.png", "--alpha", "-o", tmp_path / "picture.jpg"), "alpha"
    )
    assert (tmp_path / "flat.png").read_bytes() == before


def test_sixteen_bits_become_eight_where_the_format_or_the_user_wants_it_and_that_is_said(
    house_files, tmp_path
):
    flat = lfcal.read_flat(house_files / "flat.png")
    camera = house_files / "camera.json"
    tifffile.imwrite(tmp_path / "flat.tif", flat.astype(np.uint16) * 257, photometric="rgb")
    pictures = {}
    for name, options in (("a.jpg", ()), ("b.png", ("--8bit",)), ("c.png", ())):
        words = ("-c", camera, "--patch-size", "6", "-o", tmp_path / name)
        result = run("render", tmp_path / "flat.tif", *words, *options)
        assert result.exit_code == 0, result.output
        assert ("8 bits: 0 to 65535 became 0 to 255 in proportion" in result.stdout) == (
            name != "c.png"
        )
        pictures[name] = lfcal.read_flat(tmp_path / name)
    assert [picture.dtype for picture in pictures.values()] == [np.uint8, np.uint8, np.uint16]
    assert np.abs(pictures["b.png"] - pictures["c.png"] / 257).max() <= 0.5
    # Grey levels: JPEG, and its brightness.
    assert np.abs(pictures["a.jpg"].astype(float) - pictures["b.png"]).mean() < 8


def test_a_command_ends_with_sentences_that_name_the_source_and_percentages(
    ask, house_files, tmp_path
):
    lines = run(*ask("render", "-o", tmp_path / "picture.png")).stdout.splitlines()
    assert [line for line in lines if not line.startswith("compiling")] == lines[-3:]
    assert lines[-3] == f"392 microlenses, 20.3 px apart, with {house_files / 'camera.json'}."
    assert re.fullmatch(
        r"Of the lenses \d+ % telescopic, \d+ % binocular, \d+(\.\d)? % unresolved \(.+\)\.",
        lines[-2],
    )
    size = "{1} x {0}".format(*lfcal.read_flat(tmp_path / "picture.png").shape)
    assert lines[-1].startswith(f"{tmp_path / 'picture.png'}: {size} px, sharp at every depth, in ")
    white = house_files / "white.png"
    told = run(
        "render",
        house_files / "flat.png",
        "--white",
        white,
        "--traditional",
        "-o",
        tmp_path / "t.png",
    ).stdout
    assert f"found on {white} (confidence" in told


def test_opposite_corners_of_a_region_come_in_any_order(ask, tmp_path):
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


def test_the_suffix_decides_in_which_form_depth_is_written(ask, tmp_path):
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


def test_the_suffix_decides_whether_views_and_focus_move(ask, tmp_path):
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
    assert_refused(run(*ask("refocus", "--at", 9, 9, "-o", tmp_path / "f.gif")), "several depths")
    quilt = run(*ask("views", "--quilt", "3x2", "--scale", "3", "-o", tmp_path / "quilt.png"))
    assert quilt.exit_code == 0 and (tmp_path / "quilt.png").exists()


def test_a_folder_in_the_place_of_a_flat_points_to_batch(house_files, tmp_path):
    refused = run("render", house_files, "-o", tmp_path / "p.png")
    assert_refused(refused, f"{house_files}: is a folder", "'lfrender batch'")


def test_flats_come_from_pipes_and_pictures_go_into_them(ask, house_files, tmp_path):
    words = ["render", "-", "-c", str(house_files / "camera.json"), "--patch-size", "6", "-o"]
    data = (house_files / "flat.png").read_bytes()
    piped = CliRunner().invoke(main, [*words, "-"], input=data)
    assert piped.exit_code == 0, piped.stderr
    run(*ask("render", "--patch-size", "6", "-o", tmp_path / "p.png"))
    (tmp_path / "piped.png").write_bytes(piped.stdout_bytes)
    assert np.array_equal(
        lfcal.read_flat(tmp_path / "piped.png"), lfcal.read_flat(tmp_path / "p.png")
    )
    assert "\nstdout: " in piped.stderr
    named = CliRunner().invoke(main, [*words, "-.tif"], input=data)
    assert named.stdout_bytes[:2] in (b"II", b"MM")
    assert_refused(CliRunner().invoke(main, [*words, "-"], input=b""), "nothing came")
    assert_refused(
        CliRunner().invoke(main, ["views", "-", "-o", "-"], input=data),
        "cannot be written to stdout",
    )


def test_published_calibrations_are_accepted(shared, tmp_path):
    flat = shared("captures", "Fujita2.png")
    for name in ("Fujita2.published.xml", "Fujita2.published.cfg"):
        camera = shared("captures", name)
        drawn = figures_of(
            "render", flat, "-c", camera, "--patch-size", "-7", "-o", tmp_path / "picture.tif"
        )
        assert drawn["camera_source"] == "published"
        assert drawn["pitch"] == pytest.approx(23.2, abs=0.3)


@pytest.mark.parametrize(("program", "words"), [("lfrender", "render --help"), ("lfcal", "--help")])
def test_help_imports_nothing_heavy(program, words):
    code = (
        f"import sys\nfrom {program}.cli.main import main\n"
        f"try: main({words.split()})\nexcept SystemExit as end: assert end.code == 0\n"
        "heavy = {'numpy', 'numba', 'scipy', 'cv2', 'PIL', 'tifffile', 'rich'}\n"
        "print([m for m in heavy if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
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
    [("render", "-c"), ("render", "--white"), ("views", "-c"), ("batch", "--white"), ("batch", "")],
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


def test_a_mosaic_flat_is_rendered_in_colour_when_its_filters_are_named(
    ask, house_files, raw_house, tmp_path
):
    camera = ("-c", house_files / "camera.json")
    figures_of("render", raw_house, *camera, "--mosaic", "RGGB", "-o", tmp_path / "picture.png")
    figures_of(*ask("render", "-o", tmp_path / "wanted.png"))
    picture, wanted = (lfcal.read_flat(tmp_path / f"{name}.png") for name in ("picture", "wanted"))
    inner = np.s_[10:-10, 10:-10]
    np.testing.assert_allclose(picture[inner].mean((0, 1)), wanted[inner].mean((0, 1)), rtol=0.02)
    assert_refused(
        run(*ask("render", "--mosaic", "RGGB", "-o", tmp_path / "refused.png")), "in colour already"
    )


def test_batch_says_what_is_doubtful_about_its_camera(house_files, moved, tmp_path):
    words = (
        "batch",
        house_files / "flat.png",
        "-c",
        moved,
        "-o",
        tmp_path / "out",
        "--preset",
        "fast",
    )
    assert "warning: the microimages lie 5.0 px beside" in run(*words).stderr
    assert "5.0 px beside" in figures_of(*words)["warnings"][0]
