"""Sequences: frames of all kinds are rendered once, runs are continued, pictures are constant where
nothing moves.
"""

from __future__ import annotations

import json
from fractions import Fraction
from itertools import islice

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from PIL import Image, ImageCms

import lfcal
import lfrender
from lfcal import read_flat
from lfcal.runtime.light.tone import encode_srgb
from lfrender.cli.main import main
from lfrender.sequence.film_file import FilmFile
from lfrender.sequence.options import FrameOptions
from lfrender.sequence.run import Run
from lfrender.sequence.run_folder import RunFolder, load_camera

#: Segments of three frames and groups of two.
SHORT = {"segment": 3, "group": 2}


@pytest.fixture(scope="module")
def sequence(house, tmp_path_factory):
    """Five frames, in the last two of which a part of the flat shows something else; the camera."""
    rng = np.random.default_rng(1)
    flats = [house.flat.copy() for _ in range(5)]
    for flat in flats[3:]:
        flat[:120, :150] = flat[200:320, 200:350]
    folder = tmp_path_factory.mktemp("frames")
    for k, flat in enumerate(flats):
        noisy = np.clip(
            flat.astype(int) + rng.integers(-1, 2, flat.shape), 0, np.iinfo(flat.dtype).max
        )
        cv2.imwrite(str(folder / f"f{k + 8}.png"), noisy.astype(flat.dtype)[..., ::-1])
    return folder, house.truth.calibration


def _pictures(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.tif"))}


def _run(sequence, folder, **options):
    frames, camera = sequence
    return list(
        lfrender.render_frames(
            lfrender.open_frames([frames]), folder, camera, preset="fast", **options
        )
    )


@pytest.fixture(scope="module")
def whole(sequence, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    return folder, _run(sequence, folder, **SHORT)


def test_frames_come_in_the_order_of_their_numbers_and_keep_depth_where_nothing_moves(whole):
    folder, results = whole
    assert [r.name for r in results] == ["f8", "f9", "f10", "f11", "f12"]
    assert {r.outcome for r in results} == {"rendered"} and len(_pictures(folder)) == 5
    assert results[1].still > 0.95 and 0.3 < results[3].still < 0.95 and results[4].still > 0.95
    sizes = {tifffile.imread(r.path).shape for r in results}
    assert len(sizes) == 1


@pytest.mark.parametrize("known", [True, False])
def test_even_frames_are_reported_and_do_not_stop_or_scale_the_others(
    house, house_white_camera, tmp_path, known
):
    flats = [np.zeros_like(house.flat), house.flat, np.full_like(house.flat, 255)]
    for name, flat in zip("abc", flats, strict=True):
        cv2.imwrite(str(tmp_path / f"{name}.png"), flat[..., ::-1])
    frames = lfrender.open_frames([tmp_path])
    camera = house_white_camera if known else None
    results = list(lfrender.render_frames(frames, tmp_path / "out", camera, preset="fast"))
    assert [one.outcome for one in results] == ["failed", "rendered", "failed"]
    assert all("dark or saturated" in one.message for one in results[::2])
    assert min(tifffile.imread(results[1].path).shape[:2]) > 50


def test_a_frame_of_another_size_is_named_by_its_file(house, tmp_path):
    for name in ("a", "b"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), house.flat[..., ::-1])
    cv2.imwrite(str(tmp_path / "c.png"), house.flat[:-10, :-20, ::-1])
    tifffile.imwrite(tmp_path / "d.tif", np.stack([house.flat[:-10]] * 2), photometric="rgb")
    words = ["batch", str(tmp_path), "-o", str(tmp_path / "out"), "--preset", "fast"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 1
    lines = done.stderr.splitlines()
    assert (
        f"{tmp_path}/c.png: has 400 x 320 px, the frames of this run have 420 x 330; "
        in done.stderr
    )
    assert any(line.startswith(f"{tmp_path}/d.tif, frame d_00001: has 420 x 320") for line in lines)


def test_resize_gives_the_size_of_pictures_and_of_films(house, tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), house.flat[..., ::-1])
    house.truth.calibration.save(tmp_path / "camera.json")
    words = ["batch", str(tmp_path / "a.png"), "-c", str(tmp_path / "camera.json")]
    words += ["--preset", "fast", "--resize", "210x164", "-o"]
    for name in ("out", "film.mkv"):
        done = CliRunner().invoke(main, [*words, str(tmp_path / name)])
        assert done.exit_code == 0 and "of 210 x 164 px" in done.stderr, done.output
    assert tifffile.imread(tmp_path / "out" / "a.tif").shape == (164, 210, 3)
    assert read_flat(tmp_path / "film.mkv", 0).shape == (164, 210, 3)
    both = CliRunner().invoke(main, [*words, str(tmp_path / "b"), "--scale", "5"])
    assert both.exit_code == 2 and "--scale and --resize exclude each other" in both.output


def test_pictures_keep_the_colour_profile_and_camera_data_of_their_frames(house, tmp_path):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    exif = Image.Exif()
    exif[0x010F] = "maker"
    Image.fromarray(house.flat).save(tmp_path / "a.png", icc_profile=profile, exif=exif)
    frames = lfrender.open_frames([tmp_path / "a.png"])
    options = {"preset": "fast", "suffix": ".png"}
    (result,) = lfrender.render_frames(frames, tmp_path / "out", house.truth.calibration, **options)
    with Image.open(result.path) as image:
        assert image.info["icc_profile"] == profile
        assert image.getexif()[0x010F] == "maker"


def test_an_interrupted_run_is_continued_with_the_same_pictures(sequence, whole, tmp_path):
    frames, camera = sequence
    started = lfrender.render_frames(
        lfrender.open_frames([frames]), tmp_path, camera, preset="fast", **SHORT
    )
    list(islice(started, 2))
    started.close()
    (tmp_path / "f9.tif").unlink()
    results = _run(sequence, tmp_path, **SHORT)
    # Of the others some may be there.
    assert [r.outcome for r in results[:2]] == ["kept", "rendered"]
    assert _pictures(tmp_path) == _pictures(whole[0])


def test_a_run_uses_the_camera_as_its_file_has_it_so_that_a_continued_one_has_the_same(
    house_white_camera, sequence, tmp_path
):
    frames = lfrender.open_frames([sequence[0]], frames="2:4")
    camera = house_white_camera
    options = FrameOptions(preset="fast", scale=4.0)
    folder = RunFolder(tmp_path, options, frames.names, overwrite=False)
    run = Run(folder, options, camera, frames)
    list(run.groups(frames, overwrite=False))
    stored = load_camera(tmp_path).gain_map
    np.testing.assert_array_equal(run.camera.gain_map.profile, stored.profile)
    assert not np.array_equal(camera.gain_map.profile, stored.profile)


def test_other_settings_are_refused_unless_everything_is_rendered_again(sequence, whole, tmp_path):
    with pytest.raises(lfcal.OutputError, match="overwrite"):
        _run(sequence, whole[0], scale=3.0)
    frames, camera = sequence
    one = lfrender.open_frames([frames / "f8.png"])
    again = {"preset": "fast", "scale": 3.0, "overwrite": True}
    # The next run would keep the other four, of another scale.
    with pytest.raises(lfcal.OutputError, match=r"holds f10\.tif of an earlier run, 4 files"):
        list(lfrender.render_frames(one, whole[0], camera, **again))
    list(lfrender.render_frames(one, tmp_path, camera, preset="fast", scale=4.0))
    list(lfrender.render_frames(one, tmp_path, camera, **again))
    assert tifffile.imread(tmp_path / "f8.tif").shape[1] == pytest.approx(3.0 * 420 / 20.3, abs=1)


def test_frames_of_16_bits_are_written_with_8_where_that_is_asked_for(house, tmp_path):
    camera = house.truth.calibration
    lfrender.write_picture(tmp_path / "f.png", house.flat.astype(np.uint16) * 257)
    frames = lfrender.open_frames([tmp_path / "f.png"])
    pictures = {}
    for bits in (8, 16):
        options = {"preset": "fast", "scale": 4.0, "eight_bits": bits == 8}
        (done,) = lfrender.render_frames(frames, tmp_path / f"of{bits}", camera, **options)
        pictures[bits] = read_flat(done.path)
    assert (pictures[8].dtype, pictures[16].dtype) == (np.uint8, np.uint16)
    assert np.abs(pictures[8] - 255 * encode_srgb(pictures[16] / 65535)).max() <= 0.51
    with pytest.raises(lfcal.OutputError, match="made with another"):
        list(
            lfrender.render_frames(
                frames, tmp_path / "of16", camera, preset="fast", eight_bits=True
            )
        )


def test_dark_frame_is_subtracted_from_every_frame_and_another_one_is_refused(house, tmp_path):
    dark = np.random.default_rng(4).integers(0, 60, house.flat.shape[:2], np.uint8)
    (tmp_path / "frames").mkdir()
    for name in ("a", "b"):
        light = np.minimum(house.flat, 190) + dark[:, :, None]
        cv2.imwrite(str(tmp_path / "frames" / f"{name}.png"), light[..., ::-1])
    cv2.imwrite(str(tmp_path / "dark.png"), dark)
    frames = lfrender.open_frames([tmp_path / "frames"], dark=tmp_path / "dark.png")
    for frame in frames:
        np.testing.assert_array_equal(frame.read(), np.minimum(house.flat, 190))
    house.truth.calibration.save(tmp_path / "camera.json")
    command = [
        "batch",
        str(tmp_path / "frames"),
        "-c",
        str(tmp_path / "camera.json"),
        "--preset",
        "fast",
    ]
    command += ["-o", str(tmp_path / "out")]
    done = CliRunner().invoke(
        main, [*command, "--dark", str(tmp_path / "dark.png")], catch_exceptions=False
    )
    assert done.exit_code == 0, done.output
    # That of the run has the blur of the lenses.
    flat = np.minimum(house.flat, 190)
    camera = load_camera(tmp_path / "out")
    expected = lfrender.render(flat, camera, lfrender.analyze(flat, camera, "fast"))
    np.testing.assert_array_equal(read_flat(tmp_path / "out" / "a.tif"), expected.image)
    refused = CliRunner().invoke(main, command)
    assert refused.exit_code == 2 and "another camera, dark frame" in refused.output


def test_depth_maps_of_all_frames_are_those_of_single_ones_and_missing_ones_are_made(
    sequence, tmp_path
):
    maps = tmp_path / "depth"
    frames, camera = sequence
    part = lfrender.open_frames([frames], frames="3:")
    plans = []
    options = {"preset": "fast", "depth_maps": maps, "announce": plans.append}
    (first, _) = lfrender.render_frames(part, tmp_path / "out", camera, **options)
    assert sorted(p.name for p in maps.iterdir()) == ["f11.npz", "f12.npz"]
    camera = load_camera(tmp_path / "out")
    expected = lfrender.analyze(read_flat(frames / "f11.png"), camera, "fast")
    np.testing.assert_array_equal(
        lfrender.DepthMap.load(maps / "f11.npz").patch_size, expected.patch_size
    )
    (maps / "f12.npz").unlink()
    outcomes = [r.outcome for r in lfrender.render_frames(part, tmp_path / "out", **options)]
    assert outcomes == ["kept", "rendered"] and (maps / "f12.npz").exists()
    size = tifffile.imread(first.path).shape[1::-1]
    assert [(plan.frames, plan.kept, plan.size) for plan in plans] == [(2, 0, size), (2, 1, size)]


def test_depth_of_a_frame_is_not_taken_for_that_of_another_at_its_place(sequence, tmp_path):
    frames, camera = sequence
    for name, folder in (("f8", "out"), ("f11", "out"), ("f11", "alone")):
        one = lfrender.open_frames([frames / f"{name}.png"])
        list(lfrender.render_frames(one, tmp_path / folder, camera, preset="fast", scale=4.0))
    assert (tmp_path / "out" / "f11.tif").read_bytes() == (
        tmp_path / "alone" / "f11.tif"
    ).read_bytes()


def test_no_picture_of_before_is_kept_when_rendering_everything_again_is_interrupted(
    sequence, tmp_path
):
    frames, camera = sequence
    frames = lfrender.open_frames([frames], frames=slice(2))
    list(lfrender.render_frames(frames, tmp_path, camera, preset="fast", scale=3.0))
    started = lfrender.render_frames(
        frames, tmp_path, camera, preset="fast", scale=4.0, overwrite=True, group=1
    )
    next(started)
    started.close()
    results = list(
        lfrender.render_frames(frames, tmp_path, camera, preset="fast", scale=4.0, group=1)
    )
    assert len({tifffile.imread(r.path).shape for r in results}) == 1


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """Ten frames in two films of 5 a second, of which the first has 6."""
    pytest.importorskip("av")
    folder = tmp_path_factory.mktemp("films")
    for name, numbers in (("a", range(6)), ("b", range(6, 10))):
        with FilmFile(folder / f"{name}.mkv", Fraction(5)) as file:
            for number in numbers:
                file.add(np.full((24, 32), 10 * number, np.uint8))
    return [folder / "a.mkv", folder / "b.mkv"]


@pytest.mark.parametrize(
    ("chosen", "numbers"),
    [
        ({"frames": "2:8:3"}, [2, 5]),
        ({"frames": "::4"}, [0, 4, 8]),
        ({"frames": "-3:"}, [7, 8, 9]),
        ({"frames": "7"}, [7]),
        ({"frames": -1}, [9]),
        ({"frames": slice(None, 2)}, [0, 1]),
        ({"start": 0.6, "end": 1.4}, [3, 4, 5, 6]),
        ({"end": 0.3}, [0, 1]),
    ],
)
def test_some_frames_are_chosen_by_number_or_time(film, chosen, numbers):
    frames = lfrender.open_frames(film, **chosen)
    read = list(frames)
    assert [frame.read()[0, 0, 0] // 10 for frame in read] == numbers
    assert frames.count == len(numbers) and frames.names == [frame.name for frame in read]
    assert frames.rate == Fraction(
        5, 4 if chosen == {"frames": "::4"} else 3 if chosen == {"frames": "2:8:3"} else 1
    )


@pytest.mark.parametrize("chosen", ["10:", "5:5", "40", "::0", "::-1", "1:2:3:4", "a", "", "1-2"])
def test_choices_without_a_frame_or_a_meaning_are_refused(film, chosen):
    with pytest.raises(ValueError, match="frames"):
        lfrender.open_frames(film, frames=chosen)


def test_seconds_need_a_rate_and_an_end_after_the_start(film, sequence):
    with pytest.raises(lfcal.FlatError, match="frame rate"):
        lfrender.open_frames([sequence[0]], start=1)
    for start, end in ((2, 1), (-1, None), (1, 1)):
        with pytest.raises(ValueError, match="start must"):
            lfrender.open_frames(film, start=start, end=end)


def test_bad_frame_is_reported_and_the_others_are_rendered(sequence, tmp_path):
    frames, camera = sequence
    inputs = tmp_path / "in"
    inputs.mkdir()
    for k in (8, 9):
        (inputs / f"f{k}.png").write_bytes((frames / f"f{k}.png").read_bytes())
    (inputs / "f7.png").write_bytes((frames / "f8.png").read_bytes()[:5000])
    cv2.imwrite(str(inputs / "f10.png"), np.zeros((40, 50), np.uint8))
    camera.save(tmp_path / "camera.json")
    arguments = [
        "batch",
        str(inputs),
        "-o",
        str(tmp_path / "out"),
        "--preset",
        "fast",
        "--format",
        "png",
        "--json",
    ]
    result = CliRunner().invoke(
        main, [*arguments, "-c", str(tmp_path / "camera.json")], catch_exceptions=False
    )
    figures = json.loads(result.stdout)
    assert result.exit_code == 1 and figures["rendered"] == 2 and figures["failed"] == 2
    assert "cannot be read" in figures["warnings"][0] and "f10" in figures["warnings"][1]
    assert sorted(path.name for path in (tmp_path / "out").glob("*.png")) == ["f8.png", "f9.png"]


def test_pages_of_a_tiff_and_a_video_are_frames(house, tmp_path):
    pages = np.stack([house.flat, house.flat[::-1], house.flat[:, ::-1]])
    tifffile.imwrite(tmp_path / "stack.tif", pages, photometric="rgb")
    frames = list(lfrender.open_frames([tmp_path / "stack.tif"]))
    assert [f.name for f in frames] == ["stack_00000", "stack_00001", "stack_00002"]
    np.testing.assert_array_equal(frames[1].read(), pages[1])

    av = pytest.importorskip("av")
    with av.open(str(tmp_path / "film.mkv"), "w") as film:
        stream = film.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = 420, 330, "bgr0"
        for page in pages:
            film.mux(
                stream.encode(av.VideoFrame.from_ndarray(page.astype(np.uint8), format="rgb24"))
            )
        film.mux(stream.encode())
    read = [frame.read() for frame in lfrender.open_frames([tmp_path / "film.mkv"])]
    np.testing.assert_array_equal(np.stack(read), pages)


@pytest.mark.parametrize("make", ["nothing", "missing", "twice"])
def test_inputs_that_are_no_sequence_are_refused(tmp_path, make):
    (tmp_path / "a").mkdir()
    inputs = {"nothing": [tmp_path / "a"], "missing": [tmp_path / "b.png"]}.get(make)
    if inputs is None:
        for name in ("c.png", "c.jpg"):
            (tmp_path / "a" / name).write_bytes(b"x")
        inputs = [tmp_path / "a"]
    with pytest.raises(lfcal.FlatError):
        lfrender.open_frames(inputs)


def _outcomes(*inputs, **chosen):
    """What reading each frame gives: its pixels, or the message of the error."""
    found = []
    for frame in lfrender.open_frames(inputs, **chosen):
        try:
            found.append(frame.read())
        except lfcal.FlatError as error:
            found.append(str(error))
    return found


def test_damaged_frames_of_videos_are_detected_and_do_not_stop_the_rest(tmp_path):
    av = pytest.importorskip("av")
    pictures = np.random.default_rng(0).integers(0, 256, (4, 40, 56, 3), dtype=np.uint8)
    path = tmp_path / "film.mkv"
    with FilmFile(path, Fraction(25)) as film:
        for picture in pictures:
            film.add(picture)
    with av.open(str(path)) as film:
        middles = [packet.pos + packet.size // 2 for packet in film.demux(video=0) if packet.size]
    whole = path.read_bytes()
    damaged = bytearray(whole)
    damaged[middles[1]] ^= 255
    path.write_bytes(damaged)
    (tmp_path / "torn.mkv").write_bytes(whole[: middles[2]])
    (tmp_path / "none.mp4").write_bytes(b"no video at all")
    found = _outcomes(path, tmp_path / "torn.mkv", tmp_path / "none.mp4")
    assert [type(f) for f in found] == [np.ndarray, str, *[np.ndarray] * 4, str, str]
    assert "film.mkv: frame 1: slice CRC" in found[1]
    np.testing.assert_array_equal(
        np.stack([found[k] for k in (0, 2, 3, 4, 5)]), pictures[[0, 2, 3, 0, 1]]
    )
    assert "torn.mkv: ends after 2 of" in found[6] and "none.mp4" in found[7]
    # A damaged frame that was not asked for is no error, the end of the film before one that was
    # is.
    assert [type(f) for f in _outcomes(path, frames="::2")] == [np.ndarray] * 2
    assert [type(f) for f in _outcomes(tmp_path / "torn.mkv", frames="1:")] == [np.ndarray, str]
