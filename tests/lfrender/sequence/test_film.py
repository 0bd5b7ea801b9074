"""Films of a sequence: its pictures at the right rate, complete or not there, and runs that can be
continued.
"""

from __future__ import annotations

import json
import sys
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from itertools import islice

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

import lfcal
import lfrender
from lfcal.runtime.output_file import claim
from lfrender.cli.main import main
from lfrender.data.rendering import Rendering
from lfrender.output.finish import Finish
from lfrender.sequence.film import render_film
from lfrender.sequence.film_file import FilmFile

av = pytest.importorskip("av")


@pytest.fixture(scope="module")
def frames(house, tmp_path_factory):
    """Five frames that differ, the first and the fourth of which cannot be read."""
    folder = tmp_path_factory.mktemp("frames")
    for k in range(5):
        flat = np.rint(house.flat * (1 - 0.1 * k)).astype(np.uint8)
        cv2.imwrite(str(folder / f"f{k}.png"), flat[..., ::-1])
    for k in (0, 3):
        damaged = folder / f"f{k}.png"
        damaged.write_bytes(damaged.read_bytes()[:3000])
    return lfrender.open_frames([folder])


@pytest.fixture(scope="module")
def pictures(frames, house, tmp_path_factory):
    """What the frames that can be read look like, one by one."""
    folder = tmp_path_factory.mktemp("pictures")
    results = list(lfrender.render_frames(frames, folder, house.truth.calibration, preset="fast"))
    return [tifffile.imread(r.path) for r in results if r.outcome == "rendered"]


def shown(path):
    with av.open(str(path)) as film:
        stream = film.streams.video[0]
        return Fraction(stream.average_rate), [
            frame.to_ndarray(format="rgb24") for frame in film.decode(stream)
        ]


def test_film_shows_every_picture_and_in_place_of_bad_frames_the_one_before(
    frames, pictures, house, tmp_path
):
    path = tmp_path / "film.mkv"
    results = list(render_film(frames, path, house.truth.calibration, preset="fast", rate=29.97))
    assert [r.outcome for r in results] == ["failed", "rendered", "rendered", "failed", "rendered"]
    rate, found = shown(path)
    assert rate == pytest.approx(29.97, abs=1e-3)
    # The first one has none before it.
    np.testing.assert_array_equal(np.stack(found), np.stack([pictures[k] for k in (0, 0, 1, 1, 2)]))
    assert [p.name for p in tmp_path.iterdir()] == ["film.mkv"]


def test_interrupted_run_leaves_no_film_and_is_continued_from_its_pictures(frames, house, tmp_path):
    path = tmp_path / "film.mkv"
    camera = house.truth.calibration
    started = render_film(frames, path, camera, preset="fast")
    list(islice(started, 3))
    started.close()
    assert not path.exists()
    pictures = list((tmp_path / ".film.mkv.unfinished").glob("*.tif"))
    pictures[0].unlink()
    results = list(render_film(frames, path, camera, preset="fast"))
    assert sorted(r.outcome for r in results) == ["failed", "failed", "kept", "kept", "rendered"]
    assert len(shown(path)[1]) == 5
    with pytest.raises(lfcal.OutputError, match="there already"):
        next(render_film(frames, path, camera, preset="fast"))


def test_part_of_a_film_lasts_as_long_and_has_a_film_of_depth_in_fixed_colours(
    frames, house, tmp_path
):
    with FilmFile(tmp_path / "in.mkv", Fraction(24)) as film:
        for scale in (1, 0.9, 0.8, 0.7, 0.6):
            film.add(np.rint(house.flat * scale).astype(np.uint8))
    house.truth.calibration.save(tmp_path / "camera.json")
    command = [
        "batch",
        str(tmp_path / "in.mkv"),
        "-c",
        str(tmp_path / "camera.json"),
        "--preset",
        "fast",
    ]
    command += ["--start", "0.04", "--frames", "1::2"]
    refused = CliRunner().invoke(main, [*command, "-o", str(tmp_path / "out.mkv")])
    assert refused.exit_code == 2 and "either frames" in refused.stderr
    command[-4:] = ["--frames", "1::2", "--depth-maps", str(tmp_path / "depth.mkv")]
    result = CliRunner().invoke(
        main, [*command, "-o", str(tmp_path / "out.mkv")], catch_exceptions=False
    )
    assert result.exit_code == 0
    (rate, sharp), (_, depth) = shown(tmp_path / "out.mkv"), shown(tmp_path / "depth.mkv")
    assert (rate, len(sharp), len(depth)) == (12, 2, 2)
    rows, columns = sharp[0].shape[:2]
    assert f"Writes 2 frames of {columns} x {rows} px, 12 a second" in result.stderr
    assert depth[0].shape == sharp[0].shape
    # The scene has not changed.
    assert np.mean(depth[0] == depth[1]) > 0.9
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "camera.json",
        "depth.mkv",
        "in.mkv",
        "out.mkv",
    ]


def test_a_film_that_is_being_written_is_refused(frames, house, tmp_path):
    path = tmp_path / "film.mkv"
    with claim(path), ThreadPoolExecutor() as pool:
        other = pool.submit(list, render_film(frames, path, house.truth.calibration))
        with pytest.raises(lfcal.OutputError, match="is being written by process"):
            other.result()
    assert not list(tmp_path.iterdir())


def test_film_that_was_begun_anew_is_finished_without_being_told_again(frames, house, tmp_path):
    path = tmp_path / "film.mkv"
    camera = house.truth.calibration
    path.write_bytes(b"an earlier film")
    started = render_film(frames, path, camera, preset="fast", overwrite=True)
    list(islice(started, 2))
    started.close()
    assert path.read_bytes() == b"an earlier film"
    assert "kept" in [r.outcome for r in render_film(frames, path, camera, preset="fast")]
    assert len(shown(path)[1]) == 5


def test_sequence_without_a_frame_that_can_be_rendered_makes_no_film(frames, house, tmp_path):
    bad = lfrender.open_frames(frames.files[:1])
    run = render_film(bad, tmp_path / "film.mkv", house.truth.calibration, preset="fast")
    assert next(run).outcome == "failed"
    with pytest.raises(lfcal.FlatError, match="none of the frames"):
        next(run)
    assert not (tmp_path / "film.mkv").exists()


def test_command_makes_a_film_that_plays_everywhere_at_the_rate_of_its_input(
    frames, pictures, house, tmp_path
):
    with FilmFile(tmp_path / "in.mkv", Fraction(12)) as film:
        for file in (frames.files[1], frames.files[2]):
            film.add(lfcal.read_flat(file))
    house.truth.calibration.save(tmp_path / "camera.json")
    command = [
        "batch",
        str(tmp_path / "in.mkv"),
        "-o",
        str(tmp_path / "out.mp4"),
        "--preset",
        "fast",
        "--json",
    ]
    result = CliRunner().invoke(
        main, [*command, "-c", str(tmp_path / "camera.json")], catch_exceptions=False
    )
    assert result.exit_code == 0 and json.loads(result.stdout)["rendered"] == 2
    with av.open(str(tmp_path / "out.mp4")) as film:
        stream = film.streams.video[0]
        assert (stream.format.name, stream.average_rate) == ("yuv420p", 12)
    rows, columns = pictures[0].shape[:2]
    for picture, frame in zip(pictures, lfrender.open_frames([tmp_path / "out.mp4"]), strict=False):
        # Colours have half the resolution, and frames an even number of rows and columns.
        there = frame.read()
        assert there.shape[:2] == (rows + rows % 2, columns + columns % 2)
        apart = there[:rows, :columns].astype(float) - picture
        assert np.std(apart @ [0.2126, 0.7152, 0.0722]) < 1.6


def test_pictures_of_ten_bits_fill_the_range_of_a_film_for_cutting(tmp_path):
    ramp = np.rint(np.linspace(0, 1023, 96)).astype(np.uint16)
    picture = np.repeat(np.tile(ramp, (33, 1))[..., None], 3, 2)
    with FilmFile(tmp_path / "film.mov", Fraction(25)) as film:
        ten = Rendering(picture, np.eye(2, 3), picture[..., 0] > 0, 1.0, 1023.0, encoded=True)
        film.add(Finish("film.mov").apply(ten).image)
    (frame,) = lfrender.open_frames([tmp_path / "film.mov"])
    there = frame.read()
    assert there.shape == (34, 96, 3) and there.dtype == np.uint16
    # FFmpeg counts 16 bits as 8 bits times 256. With 8 bits values would step by 4.
    assert np.abs(there[:33] / 0xFF00 * 1023 - picture).mean() < 0.7


def test_even_areas_keep_their_colours_to_a_grey_level_through_a_film_and_back(tmp_path):
    colours = np.random.default_rng(1).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    picture = np.repeat(np.repeat(colours, 16, 0), 16, 1)
    with FilmFile(tmp_path / "film.mp4", Fraction(25)) as film:
        film.add(picture)
    (frame,) = lfrender.open_frames([tmp_path / "film.mp4"])
    middles = frame.read()[8::16, 8::16].astype(int)
    assert np.abs(middles - colours).max() <= 3
    assert np.abs((middles - colours).mean((0, 1))).max() < 0.35


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_lossless_film_holds_pixels_of_all_kinds_bit_for_bit(tmp_path, kind, channels):
    values = np.random.default_rng(0).random((3, 31, 45, *channels))
    whole = (
        values.astype(np.float32)
        if kind == np.float32
        else (values * np.iinfo(kind).max).astype(kind)
    )
    stored = np.rint(whole * 65535).astype(np.uint16) if kind == np.float32 else whole
    with FilmFile(tmp_path / "film.mkv", Fraction(25)) as film:
        for picture in whole:
            film.add(picture)
    name = {1: "gray", 2: "gray16le"} if not channels else {1: "rgb24", 2: "rgb48le"}
    with av.open(str(tmp_path / "film.mkv")) as film:
        found = [f.to_ndarray(format=name[stored.dtype.itemsize]) for f in film.decode(video=0)]
    np.testing.assert_array_equal(np.stack(found), stored)


def test_pictures_of_a_film_must_be_of_one_kind(tmp_path):
    with FilmFile(tmp_path / "film.mkv", Fraction(25)) as film:
        film.add(np.full((20, 30, 3), 50, np.uint8))
        for other in (np.zeros((20, 31, 3), np.uint8), np.zeros((20, 30), np.uint8)):
            with pytest.raises(lfcal.LightFieldError, match="of one kind"):
                film.add(other)
    assert len(shown(tmp_path / "film.mkv")[1]) == 1


def test_films_need_a_package_a_known_ending_and_room(frames, house, tmp_path, monkeypatch):
    run = CliRunner().invoke
    flat = str(frames.files[1])
    assert (
        "unknown output format"
        in run(main, ["batch", flat, "-o", str(tmp_path / "film.avi")]).stderr
    )
    assert (
        "--format"
        in run(main, ["batch", flat, "-o", str(tmp_path / "film.mp4"), "--format", "png"]).stderr
    )
    assert (
        "--fps" in run(main, ["batch", flat, "-o", str(tmp_path / "folder"), "--fps", "3"]).stderr
    )

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(FilmFile, "_frame", full)
        with pytest.raises(lfcal.OutputError, match="No space left"):
            list(render_film(frames, tmp_path / "film.mkv", house.truth.calibration, preset="fast"))
    assert not (tmp_path / "film.mkv").exists()
    monkeypatch.setitem(sys.modules, "av", None)
    found = run(main, ["batch", flat, "-o", str(tmp_path / "film.mp4")])
    assert found.exit_code == 2 and "pip install 'av>=" in found.stderr
