"""Large white images: found in one piece, extended outwards, calibrated on parts."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import lfcal
from benchmarks import white_images
from lfcal.detection import downscale, search
from lfcal.runtime.errors import CalibrationError
from lfcal.white_fit import large

_SIZE = (1100, 850)


@pytest.fixture
def found_lattices(monkeypatch, set_downscale):
    """Small images count as large; collects the lattices that were found on them."""
    set_downscale(pieces=5e5)
    found = []
    original = large.find_white_lattice

    def seen(*args, **options):
        found.append(original(*args, **options))
        return found[-1]

    monkeypatch.setattr(large, "_FIRST_SIDE", 300)
    monkeypatch.setattr(large, "_PIECE_SIDE", 100)
    monkeypatch.setattr(large, "find_white_lattice", seen)
    return found


@pytest.fixture
def in_parts(found_lattices, monkeypatch, set_downscale):
    """Small images count as too large to be held as a whole."""
    set_downscale(pieces=5e5, large=5e5)
    monkeypatch.setattr(large, "sample_parts", partial(large.sample_parts, side=160, pixels=6e5))
    return found_lattices


def _error(camera, truth):
    found = camera.lattice.centres()
    index = truth.index_of(found)
    assert len(np.unique(index, axis=0)) == len(found), "two found centres share a true one"
    return float(np.sqrt(((found - truth.centres(index)) ** 2).sum(1).mean()))


@pytest.fixture(scope="module")
def bent():
    truth = white_images.WhiteImage("hexagonal", 9.3, 3.0, 30.0, k1=0.012, size=_SIZE)
    return truth, truth.image()


def test_lattice_is_extended_through_a_distortion_of_more_than_half_a_pitch(bent, found_lattices):
    truth, image = bent
    # Where a straight lattice through the middle would put the corners.
    corner = truth.index_of(np.array([[10.0, 10.0]]))
    straight = truth.origin + corner @ truth.basis
    assert np.hypot(*(truth.centres(corner) - straight)[0]) > 0.5 * truth.pitch
    assert _error(lfcal.calibrate(image), truth) < 0.002
    assert found_lattices[0].lattice.distortion.k1 == pytest.approx(0.012, abs=1e-3)


def test_very_large_image_is_calibrated_on_parts_of_it(bent, in_parts):
    truth, image = bent
    assert downscale.choose_block_size(image, False) == 1
    colour = np.dstack([image] * 3)
    camera = lfcal.calibrate(colour)
    assert camera.source == "white"
    assert camera.image_size == _SIZE
    assert in_parts[0] is not None
    assert _error(camera, truth) < 0.004
    # A gain map that is right everywhere leaves no trace of the microimages' shading.
    flattened = camera.flatten(image).astype(float)
    known = np.isfinite(camera.gain())
    assert flattened[known].std() / flattened[known].mean() < 0.06


def test_dark_part_of_a_very_large_image_is_reported_as_defects(in_parts):
    truth = white_images.WhiteImage("square", 10.1, 1.0, 30.0, size=_SIZE)
    image = truth.image()
    image[:, 640:] //= 200
    camera = lfcal.calibrate(image)
    assert _error(camera, truth) < 0.01
    centres = camera.lattice.points(camera.defects.lenses)
    assert len(centres) == pytest.approx(850 * 460 / 10.1**2, rel=0.05)
    assert centres[:, 0].min() > 630


def test_array_beside_the_middle_of_a_very_large_image_is_found(in_parts):
    truth = white_images.WhiteImage("hexagonal", 9.3, 3.0, 30.0, size=_SIZE)
    image = truth.image()
    image[:, 400:] = 0
    assert _error(lfcal.calibrate(image), truth) < 0.03


def test_scene_with_an_even_middle_is_no_white_image(found_lattices):
    truth = white_images.WhiteImage("hexagonal", 14.3, 3.0, 40.0, size=_SIZE)
    rng = np.random.default_rng(0)
    shown = 0.1 + 0.9 * rng.random((85, 110)).repeat(10, 0).repeat(10, 1)
    shown[250:600, 340:760] = 0.7
    # Every lens shows its surroundings at a patch size of -0.3 pitches.
    lattice = lfcal.Lattice(truth.origin, truth.basis, _SIZE, 7.0)
    y, x = np.mgrid[: _SIZE[1], : _SIZE[0]]
    pixels = np.stack([x, y], -1).reshape(-1, 2)
    centres = lattice.points(np.rint(lattice.to_index(pixels)))
    column, row = np.rint(centres + (pixels - centres) / 0.3).astype(int).T
    scene = shown[np.clip(row, 0, 849), np.clip(column, 0, 1099)].reshape(x.shape)
    camera = lfcal.calibrate((truth.image() * scene).astype(np.uint16))
    assert not any(found_lattices)
    assert camera.source == "scene"


def test_very_large_flat_without_a_lattice_is_refused(in_parts):
    noise = np.random.default_rng(0).integers(0, 255, (800, 1000)).astype(np.uint8)
    with pytest.raises(CalibrationError):
        lfcal.calibrate(noise)


def test_scenes_are_told_from_white_images_by_their_strongest_period(shared, monkeypatch):
    measured = []
    original = search._measure_period

    def seen(*args):
        measured.append(args)
        return original(*args)

    monkeypatch.setattr(search, "_measure_period", seen)
    for name in ("Fujita2.png", "MiniGarden2.webp", "Boys2.webp"):
        flat = lfcal.read_flat(shared("captures", name))
        size = flat.shape[1], flat.shape[0]
        measured.clear()
        assert large.find_white_lattice(large.window_reader(flat, False), size, False, 1) is None
        assert len(measured) <= 1, name


def test_piece_of_a_white_image_gives_its_lattice(whites):
    white = whites.white_image(whites.turned(whites.HEXAGON, 27.3, 17), (1103, 905))[0]
    size = white.shape[1], white.shape[0]
    found = large.find_white_lattice(large.window_reader(white, False), size, False, 1)
    assert found.lattice.pitch == pytest.approx(27.3, abs=0.01)
    assert large.find_white_lattice(large.window_reader(0 * white, False), size, False, 1) is None
