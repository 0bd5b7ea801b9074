"""Live frames: sources, the newest one only, recordings that are rendered with the same bits, and
the page's server.
"""

from __future__ import annotations

import http.client
import json
import signal
import socket
import threading
import time
from dataclasses import replace
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

import lfcal
import lfrender
from lfrender.cli.main import main
from lfrender.live.grabber import Grabber
from lfrender.live.recording import Recorder, read_recording
from lfrender.live.server import LiveServer
from lfrender.live.session import Session, View, _in_colour
from lfrender.live.sources import Shot, SourceError, open_source, to_flat


class Camera:
    """A source that gives a frame whenever it is asked to, and can be pulled out."""

    def __init__(self, *frames):
        self.frames, self.ready, self.plugged, self.opened = frames, threading.Semaphore(), True, 0

    def __call__(self):
        self.opened += 1
        for number in range(1_000_000):
            self.ready.acquire()
            if not self.plugged:
                raise SourceError("camera: gives no more frames")
            yield Shot(self.frames[number % len(self.frames)])

    def shoot(self, count=1):
        for _ in range(count):
            self.ready.release()


def wait_until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.005)


@pytest.fixture(scope="module")
def camera(house_white_camera):
    return house_white_camera


@pytest.fixture
def session(house, camera, tmp_path):
    """A live session of a camera that shows the house, and that camera."""
    shifted = np.roll(house.flat, 1, 1)
    source = Camera(house.flat, shifted)
    made = Session(Grabber(source), lambda shot: camera, "fast", tmp_path, given=True)
    made.start(strict=True)
    yield made, source
    made.grabber._stopped.set()
    source.shoot()
    made.close()


def test_files_are_played_again_and_again_and_damaged_ones_are_lost(tmp_path):
    for name, value in (("f1", 10), ("f3", 30)):
        lfrender.write_picture(tmp_path / f"{name}.png", np.full((20, 30), value, np.uint8))
    (tmp_path / "f2.png").write_bytes((tmp_path / "f1.png").read_bytes()[:40])
    frames = open_source(str(tmp_path), rate=1000)
    shots = [next(frames) for _ in range(4)]
    assert [int(shot.pixels[0, 0]) for shot in shots] == [10, 30, 10, 30]
    assert [shot.lost for shot in shots] == [0, 1, 0, 1]


def test_a_video_is_read_by_opencv_until_it_ends(tmp_path):
    import cv2

    # A suffix that no reader of flats has.
    path = str(tmp_path / "stream.mpg")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MPG1"), 25, (64, 48))
    for _ in range(5):
        writer.write(np.full((48, 64, 3), (40, 80, 160), np.uint8))
    writer.release()
    frames = open_source(path)
    np.testing.assert_allclose(next(frames).pixels[24, 32], (160, 80, 40), atol=6)
    with pytest.raises(SourceError, match="gives no more frames"):
        list(frames)


@pytest.mark.parametrize(
    ("name", "data", "expected", "mosaic", "white"),
    [
        ("Mono8", [1, 2, 3, 4], [[1, 2], [3, 4]], None, None),
        ("BayerRG8", [1, 2, 3, 4], [[1, 2], [3, 4]], "RGGB", None),
        ("Mono16", [1, 2, 0, 1, 0, 0, 255, 255], [[513, 256], [0, 65535]], None, None),
        ("BayerGB12", [1, 2, 0, 1, 0, 0, 255, 15], [[513, 256], [0, 4095]], "GBRG", 4095),
        (
            "Mono12p",
            [0x21, 0x43, 0x65, 0xFF, 0x0F, 0x80],
            [[0x321, 0x654], [0xFFF, 0x800]],
            None,
            4095,
        ),
        (
            "Mono12Packed",
            [0x21, 0x43, 0x65, 0xFF, 0x0F, 0x80],
            [[0x213, 0x654], [0xFFF, 0x800]],
            None,
            4095,
        ),
        ("BGR8", range(12), [[[2, 1, 0], [5, 4, 3]], [[8, 7, 6], [11, 10, 9]]], None, None),
    ],
)
def test_pixel_formats_of_genicam_are_unpacked(name, data, expected, mosaic, white):
    given = np.array(list(data), np.uint8)
    shot = to_flat(name, given, 2, 2)
    given[:] = 0  # the camera has its buffer back
    np.testing.assert_array_equal(shot.pixels, expected)
    assert (shot.mosaic, shot.white, shot.encoded) == (mosaic, white, False)
    with pytest.raises(SourceError, match="YUV422_8 are not read"):
        to_flat("YUV422_8", given, 2, 2)


@pytest.mark.parametrize("name", ["Mono8", "Mono16", "Mono12p", "Mono12Packed", "BGR8"])
@pytest.mark.parametrize("size", [0, 1, 7])
def test_incomplete_frames_of_genicam_are_refused(name, size):
    with pytest.raises(SourceError, match="incomplete"):
        to_flat(name, np.ones(size, np.uint8), 3, 3)


@pytest.mark.parametrize("size", [14, 15])
def test_an_odd_number_of_packed_pixels_is_unpacked(size):
    data = np.resize(np.array([0x21, 0x43, 0x65], np.uint8), size)
    np.testing.assert_array_equal(
        to_flat("Mono12p", data, 3, 3).pixels.ravel(), [*[0x321, 0x654] * 4, 0x321]
    )


@pytest.mark.parametrize("mosaic", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("recorded", [True, False])
def test_raw_mosaics_get_their_colours(mosaic, recorded):
    cell = np.array(["RGB".index(letter) for letter in mosaic]).reshape(2, 2)
    flat = np.array([90, 120, 40], np.uint8)[np.tile(cell, (12, 16))]
    camera = lfcal.Calibration(
        lfcal.Lattice((8, 8), ((8, 0), (0, 8)), (32, 24), 4.0), mosaic=mosaic
    )
    colours = _in_colour(Shot(flat, recorded=recorded), camera)
    assert np.unique(colours.reshape(-1, 3), axis=0).tolist() == [[90, 120, 40]]


def test_only_the_newest_frame_is_taken_and_the_others_are_counted():
    source = Camera(*(np.full((4, 4), value, np.uint8) for value in range(9)))
    grabber = Grabber(source)
    assert grabber.take(1).pixels[0, 0] == 0
    source.shoot(5)
    wait_until(lambda: grabber.received == 6)
    assert grabber.take(1).pixels[0, 0] == 5
    assert (grabber.received, grabber.lost) == (6, 4)
    assert grabber.take(0.01) is None


def test_a_camera_that_was_pulled_out_is_opened_again(monkeypatch):
    monkeypatch.setattr("lfrender.live.grabber._AGAIN", 0.02)
    source = Camera(np.zeros((4, 4), np.uint8))
    grabber = Grabber(source)
    source.plugged = False
    source.shoot(3)
    wait_until(lambda: source.opened >= 3)
    assert grabber.message == "camera: gives no more frames"
    source.plugged = True
    source.shoot()
    wait_until(lambda: grabber.received == 2)
    assert grabber.message == ""


def test_a_recording_is_rendered_with_the_bits_of_the_live_pictures(session, tmp_path):
    live, source = session
    live.picture("sharp", 0)  # somebody looks at it
    live.command("record")
    shown = []
    for number in (1, 2):
        source.shoot()
        shown.append(live.picture("sharp", number)[0])
    live.command("stop")
    (file,) = tmp_path.glob("recording-*.tif")
    with tifffile.TiffFile(file) as tiff:
        frames = [json.loads(page.description)["frame"] for page in tiff.pages]
    assert frames == [view.shot.number for view in shown]
    found = read_recording(file)
    assert found.camera == live.camera and (found.preset, found.scale) == ("fast", live.scale)
    picture = tmp_path / "picture.tif"
    done = CliRunner().invoke(main, ["render", str(file), "--page", "1", "-o", str(picture)])
    assert done.exit_code == 0, done.output
    np.testing.assert_array_equal(lfcal.read_flat(picture), shown[1].sharp.image)


def test_still_scenes_keep_their_depth_and_pictures_follow_the_place_in_focus(session, house):
    live, source = session
    source.frames = (house.flat,)
    first = live.picture("sharp", 0)[0]
    source.shoot()
    second = live.picture("sharp", first.shot.number)[0]
    assert live.still == 1.0
    np.testing.assert_array_equal(first.sharp.image, second.sharp.image)
    near, far = (second.draw("focus", at) for at in ((0.2, 0.2), (0.8, 0.9)))
    assert near.shape == far.shape and np.any(near != far)
    for kind in ("raw", "traditional", "depth"):
        assert second.draw(kind).dtype == np.uint8
    assert "rotation: 1.3" in live.status()["camera"] and "tilt" not in live.status()["camera"]


def test_a_dark_frame_is_subtracted_from_live_pictures_and_not_from_recordings(
    house, camera, tmp_path
):
    lifted = np.minimum(house.flat, 239) + np.uint8(16)
    tifffile.imwrite(tmp_path / "dark.tif", np.full(lifted.shape[:2], 16, np.uint8))
    source = Camera(lifted)
    # As the commands take it: a dark frame is subtracted from linear values.
    linear = replace(camera, encoded=False)
    live = Session(
        Grabber(source),
        lambda shot: linear,
        "fast",
        tmp_path,
        given=True,
        correct=lambda pixels: pixels - np.uint8(16),
    )
    live.start(strict=True)
    shown, _ = live.picture("sharp", 0)
    live.command("record")
    source.shoot()
    shown, _ = live.picture("sharp", 1)
    live.command("stop")
    live.grabber._stopped.set()
    source.shoot()
    live.close()
    np.testing.assert_array_equal(shown.flat, np.minimum(house.flat, 239))
    (file,) = tmp_path.glob("recording-*.tif")
    np.testing.assert_array_equal(lfcal.read_flat(file), lifted)
    words = ["render", file, "--dark", tmp_path / "dark.tif", "-o", tmp_path / "picture.tif"]
    done = CliRunner().invoke(main, list(map(str, words)))
    assert done.exit_code == 0, done.output
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "picture.tif"), shown.sharp.image)


def test_live_refuses_a_dark_frame_of_another_camera(house_files, tmp_path):
    tifffile.imwrite(tmp_path / "dark.tif", np.zeros((40, 30), np.uint8))
    words = ["live", house_files / "flat.png", "--dark", tmp_path / "dark.tif", "-o", tmp_path]
    done = CliRunner().invoke(main, [*map(str, words), "--no-browser"])
    assert done.exit_code == 2 and "dark.tif: dark frame has shape (40, 30, 1)" in done.stderr


def test_nothing_is_analysed_while_nobody_looks_and_a_page_gets_the_newest_frame(
    session, tmp_path, monkeypatch
):
    live, source = session
    analysed = []
    analyze = live._analyze
    monkeypatch.setattr(live, "_analyze", lambda view: analysed.append(view) or analyze(view))
    live.command("record")
    source.shoot(4)
    wait_until(lambda: live.shot is not None and live.shot.number == 5)
    wait_until(lambda: live.grabber.recorder.frames == 4)
    live.command("stop")
    live.command("snapshot")
    assert analysed == [] and live.view is None
    (snapshot,) = tmp_path.glob("snapshot-*.tif")
    np.testing.assert_array_equal(lfcal.read_flat(snapshot), live.shot.pixels)
    view, _ = live.picture("traditional", 0)
    assert view.shot.number == 5 and analysed == [view]


def test_files_are_not_read_while_nobody_looks(camera, house_files, tmp_path):
    grabber = Grabber(lambda: open_source(str(house_files / "flat.png"), rate=1000))
    live = Session(grabber, lambda shot: camera, "fast", tmp_path, given=True)
    live.start(strict=True)
    time.sleep(0.3)
    idle = grabber.received
    time.sleep(0.3)
    assert grabber.received <= idle + 1
    live.picture("raw", 0)
    wait_until(lambda: grabber.received > idle + 20)
    live.close()


def test_a_recording_without_frames_is_no_file(session, tmp_path):
    live, _ = session
    live.command("record")
    live.command("stop")
    assert list(tmp_path.iterdir()) == [] and live.saved == "no frame came: nothing was recorded"


def test_a_recording_that_the_disk_cannot_follow_skips_frames_and_says_so(tmp_path, monkeypatch):
    recorder = Recorder(tmp_path / "r.tif", {"camera": None, "preset": "fast", "scale": None})

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(recorder._file, "write", full)
    recorder.add(Shot(np.zeros((4, 4), np.uint8)))
    recorder.close()
    assert recorder.skipped == 1
    assert "recording has ended (No space left on device)" in recorder.message


def ask(server, path, method="GET", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=5)
    connection.request(
        method, path, headers={name.replace("_", "-"): value for name, value in headers.items()}
    )
    response = connection.getresponse()
    content = response.read()
    connection.close()
    return response.status, content


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_the_server_answers_its_page_alone_and_beyond_the_loopback_whoever_has_the_token(
    session, host
):
    with LiveServer(session[0], "camera", host) as server:
        token = f"&token={server.token}" if server.token else ""
        assert ask(server, f"/?{token}")[0] == 200
        status, content = ask(server, f"/frame?kind=raw{token}")
        assert (status, content[:2]) == (200, b"\xff\xd8")
        assert json.loads(ask(server, f"/status?{token}")[1])["received"] == 1
        assert ask(server, f"/frame?kind=raw&x=7{token}")[0] == 400
        assert ask(server, f"/etc/passwd?{token}")[0] == 404
        # Pages of others cannot send the header.
        assert ask(server, f"/snapshot?{token}", "POST")[0] == 403
        assert ask(server, f"/snapshot?{token}", "POST", X_Lfrender="1")[0] == 200
        assert ask(server, f"/delete?{token}", "POST", X_Lfrender="1")[0] == 404
        if host == "0.0.0.0":
            assert len(server.token) > 20
            for path in ("/", "/status", "/frame?kind=raw&token=no"):
                assert ask(server, path) == (
                    403,
                    b"open the address with its token, as 'lfrender live' prints it",
                )
            host = urlsplit(server.url).hostname
            assert host != socket.gethostname() and socket.getaddrinfo(
                host, None, flags=socket.AI_NUMERICHOST
            )
        else:
            assert not server.token
            assert ask(server, "/", Host="elsewhere.example")[0] == 403
    assert len(list(session[0].folder.glob("snapshot-*.tif"))) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nothing.avi"], "nothing.avi: no such file or folder"),
        (["7"], "7: OpenCV finds no camera, stream or video there"),
        (["videotestsrc ! appsink"], "built without GStreamer"),
        (["7", "--pixel-format", "Mono8"], "is for GenICam cameras"),
    ],
)
def test_bad_sources_are_refused_in_one_line(words, message, tmp_path):
    done = CliRunner().invoke(main, ["live", *words, "--no-browser", "-o", str(tmp_path)])
    assert done.exit_code == 2
    assert message in done.output and done.output.count("\n") == 1


def test_a_gentl_producer_gives_frames():
    genicam = pytest.importorskip("genicam")
    pytest.importorskip("harvesters")
    from pathlib import Path

    producer = str(Path(genicam.__file__).with_name("viky.cti"))
    before = signal.getsignal(signal.SIGINT)
    frames = open_source(f"{producer}:VikyTL_DEV_green", "Mono8")
    shot = next(frames)
    assert shot.pixels.shape == (400, 400) and shot.pixels.dtype == np.uint8
    assert signal.getsignal(signal.SIGINT) is before  # Ctrl-C ends the program
    frames.close()
    with pytest.raises(SourceError, match="no such camera; this producer finds VikyTL_DEV_red"):
        next(open_source(f"{producer}:none"))
    with pytest.raises(SourceError, match="Mono99"):
        next(open_source(producer, "Mono99"))


def test_the_light_of_a_frame_tells_clipping_and_focus(house):
    def light(pixels, **more):
        return View(Shot(pixels, **more), pixels).light

    sharp = light(house.flat)
    assert sum(sharp["histogram"]) > 10_000 and len(sharp["histogram"]) == 32
    assert sharp["sharpness"] > 1.5 * light(cv2.GaussianBlur(house.flat, (0, 0), 1.5))["sharpness"]
    half = np.full((90, 90), 1000, np.uint16)
    half[:, 45:] = 4095
    assert light(half, white=4095.0)["clipped"] == pytest.approx(0.5, abs=0.02)
    assert light(half)["clipped"] == 0


def test_depth_is_asked_for_by_place_and_pictures_by_plane(session):
    live, _ = session
    with LiveServer(live, "camera") as server:
        assert ask(server, "/depth")[0] == 204
        assert live.status()["planes"] is None
        live.picture("focus", 0)
        view = live.view
        status, content = ask(server, "/depth?x=0.4&y=0.6")
        assert status == 200
        known = json.loads(content)
        assert known["patch_size"] == pytest.approx(view.patch_size((0.4, 0.6)))
        assert 0 <= known["confidence"] <= 1 and known["distance"] is None
        planes = live.status()["planes"]
        assert 0 < planes["far"] < planes["near"] < 2 * planes["pitch"]
        by_plane = ask(server, f"/frame?kind=focus&plane={known['patch_size']}")
        assert by_plane == ask(server, "/frame?kind=focus&x=0.4&y=0.6")
        assert ask(server, "/depth?x=-1")[0] == ask(server, "/frame?kind=focus&plane=far")[0] == 400
        assert ask(server, "/frame?kind=focus&plane=1e9")[0] == 500
