"""What commands read, and what they print."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

import lfcal
from lfcal.runtime.light.tone import encode_srgb
from lfrender.cli.main import main


def test_a_flat_in_which_no_lens_has_a_depth_is_warned_about(
    ask, house_files, tmp_path, run, figures_of
):
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


def test_sixteen_bits_become_eight_where_the_format_or_the_user_wants_it_and_that_is_said(
    house_files, tmp_path, run
):
    flat = lfcal.read_flat(house_files / "flat.png")
    camera = house_files / "camera.json"
    tifffile.imwrite(tmp_path / "flat.tif", flat.astype(np.uint16) * 257, photometric="rgb")
    pictures = {}
    for name, options in (("a.jpg", ()), ("b.png", ("--8bit",)), ("c.png", ())):
        words = ("-c", camera, "--patch-size", "6", "-o", tmp_path / name)
        result = run("render", tmp_path / "flat.tif", *words, *options)
        assert result.exit_code == 0, result.output
        told = "8 bits: 0 to 65535 became 0 to 255 by the curve of sRGB"
        assert (told in result.stdout) == (name != "c.png")
        pictures[name] = lfcal.read_flat(tmp_path / name)
    assert [picture.dtype for picture in pictures.values()] == [np.uint8, np.uint8, np.uint16]
    shown = 255 * encode_srgb(pictures["c.png"] / 65535)
    assert np.abs(pictures["b.png"] - shown).max() <= 0.51
    # Grey levels: JPEG, and its brightness.
    assert np.abs(pictures["a.jpg"].astype(float) - pictures["b.png"]).mean() < 8


def test_a_command_ends_with_sentences_that_name_the_source_and_percentages(
    ask, house_files, tmp_path, run
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


def test_flats_come_from_pipes_and_pictures_go_into_them(
    ask, house_files, tmp_path, run, assert_refused
):
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


def test_published_calibrations_are_accepted(shared, tmp_path, figures_of):
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


@pytest.mark.parametrize(
    "command, source",
    [("render", "-c"), ("render", "--white"), ("views", "-c"), ("batch", "--white"), ("batch", "")],
)
def test_colour_filters_that_nobody_named_are_found_on_the_flat_and_said_to_be_a_guess(
    house_files, raw_house, tmp_path, command, source, run
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


def test_batch_says_what_is_doubtful_about_its_camera(
    house_files, moved, tmp_path, run, figures_of
):
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
