"""The most probable lattice is the right one, on arrays of all kinds; what is no array is
improbable.
"""

from __future__ import annotations

from dataclasses import MISSING, fields

import cv2
import numpy as np
import pytest

import lfcal
from benchmarks.camera_kinds import draw_kind
from benchmarks.lattices.fit import whole_centres
from benchmarks.lattices.judgement import compare_with_centres
from benchmarks.lattices.random_cameras import draw_camera
from benchmarks.no_flats import draw_no_flat
from data_synth import SCENES, Camera, simulate
from lfcal.camera.evidence import Evidence
from lfcal.detection import search
from lfcal.detection.cell_maps import measure_classes
from lfcal.detection.features import FlatFeatures
from lfcal.detection.neighbours import measure_likeness
from lfcal.detection.search import find_candidates
from lfcal.images.preprocessing import sqrt_luminance
from lfcal.lattice.lattice import Lattice


@pytest.mark.parametrize(
    "seed",
    [
        0,
        3,
        23,
        231,
        607,
        1018,
        1029,
        1119,
        1135,
        *(pytest.param(n, marks=pytest.mark.nightly) for n in (1, 14, 26, 705, 910)),
    ],
)
def test_lattices_of_random_cameras_are_found_at_the_first_try(seed):
    drawn = draw_camera(seed)
    camera = lfcal.calibrate(drawn.image)
    assert compare_with_centres(camera.lattice, drawn.centres).is_right, drawn.name
    assert camera.confidence > 0.5
    assert camera.source == ("white" if drawn.white else "scene")


@pytest.mark.parametrize(
    "seed",
    [0, 13, 17, 205, *(pytest.param(n, marks=pytest.mark.nightly) for n in (4, 10, 27, 122))],
)
def test_pictures_that_are_no_flats_are_refused(seed):
    _, picture = draw_no_flat(seed)
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(picture)


@pytest.mark.parametrize(
    ("name", "pitch", "centre"),
    [
        ("bright_gaps.png", 32.222, 515.6),
        ("spots_white.png", 25.45, None),
        ("square_gaps.png", 34.90, None),
        ("elemental_16px.png", 16.0, 8.5),
    ],
)
def test_hard_files_have_the_right_lattice(shared, name, pitch, centre):
    camera = lfcal.calibrate(shared("captures", "hard", name))
    assert camera.lattice.pitch == pytest.approx(pitch, abs=0.01)
    assert camera.confidence > 0.9
    if centre is not None:
        index = camera.lattice.to_index([[centre, centre]])
        assert np.abs(index - np.rint(index)).max() < 0.02


def test_touching_cells_lie_on_their_thin_lines_and_not_on_blocks_of_jpeg(shared):
    """Of 63 lines each way, 56 and 50 lie within 1.5 px of these, measured one by one."""
    camera = lfcal.calibrate(shared("captures", "hard", "touching_cells.jpg"))
    across, down = np.meshgrid(np.arange(4, 67) + 0.5, np.arange(4, 67) + 0.5)
    centres = np.stack([6.9 + 63.80 * across, 6.1 + 63.80 * down], -1).reshape(-1, 2)
    found = compare_with_centres(camera.lattice, centres)
    assert found.is_right
    assert found.distance < 0.01
    assert camera.confidence > 0.9


@pytest.mark.parametrize(("fill", "lattice"), [(1.15, "square"), (1.2, "hex"), (1.3, "square")])
def test_white_images_of_overlapping_microimages_are_centred_on_them_not_on_the_overlap(
    fill, lattice
):
    camera = Camera.design((520, 420), 23.0, lattice, 2.0, microimage_fill=fill)
    capture = simulate(SCENES["house"](camera), camera, samples=1, noise=(5000, 8))
    found = lfcal.calibrate(capture.white)
    centres = capture.truth.calibration.lattice.centres()
    assert compare_with_centres(found.lattice, centres).is_right
    assert found.source == "white"
    assert found.confidence > 0.8


def test_signed_flats_have_the_lattice_of_unsigned_ones(shared):
    assert lfcal.calibrate(shared("captures", "hard", "int16.tif")).lattice.pitch == pytest.approx(
        23.2, abs=0.01
    )


def test_a_bare_array_under_a_microscope_is_refused(shared):
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(shared("captures", "hard", "mla_photo.jpg"))


@pytest.mark.parametrize("seed", [929, pytest.param(907, marks=pytest.mark.nightly)])
def test_content_and_parts_of_cells_are_not_sure_to_be_an_array(seed):
    """Half a cell of a board, and an object with little parallax that repeats at its pitch."""
    drawn = draw_camera(seed)
    try:
        camera = lfcal.calibrate(drawn.image)
    except lfcal.CalibrationError:
        return
    assert compare_with_centres(camera.lattice, drawn.centres).is_right or camera.confidence < 0.8


def test_cells_are_compared_by_rows_and_by_their_facing_sides():
    light = np.random.default_rng(0).normal(0, 20, (400, 500))
    scene = cv2.GaussianBlur(light, (0, 0), 8.0) * 8 + 120
    y, x = np.indices(scene.shape)
    bars = (x % 20 > 2) & (y % 20 > 2)
    mesh = np.where(bars, scene, 10).astype(np.float32)
    lattice = lfcal.Lattice(np.array([11.0, 11.0]), 20 * np.eye(2), (500, 400), 9.0)
    likeness = measure_likeness(mesh, lattice)
    assert likeness.continued > 0.3 > likeness.parallax
    features = FlatFeatures(mesh)
    assert measure_classes(features, lattice.basis).share < 0.08
    assert measure_classes(features, lattice.basis / [[1], [2]]).share > 0.15


def test_elemental_images_full_of_content_are_found():
    camera = Camera.design((520, 420), 27.0, "square", 1.0, microimage_fill=1.0, focus=0.06)
    camera = camera.replace(square_aperture=True, natural_vignetting=False)
    capture = simulate(SCENES["plane"](camera), camera, samples=3, noise=(4000, 6))
    found = lfcal.calibrate(capture.flat)
    assert compare_with_centres(found.lattice, capture.truth.calibration.lattice.centres()).is_right
    assert found.confidence > 0.8


@pytest.mark.parametrize("seed", [300, 301])
def test_tiles_of_single_tones_are_refused(seed):
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(draw_no_flat(seed)[1])


@pytest.mark.parametrize("seed", [0, 3])
def test_thin_dark_lines_between_square_lenses_are_a_lattice(seed):
    """The strongest period of the spectrum may be shorter than any microimage (seed 3)."""
    capture = draw_kind(seed)[1]
    camera = lfcal.calibrate(capture.flat)
    centres = whole_centres(capture.truth.calibration.lattice)
    assert compare_with_centres(camera.lattice, centres).is_right
    assert camera.confidence > 0.9


@pytest.mark.filterwarnings("error")
def test_long_narrow_cells_are_not_measured():
    y, x = np.indices((420, 500))
    noise = np.random.default_rng(5).normal(0, 0.05, x.shape)
    bars = ((x % 8 < 4) & (y % 70 < 64)) + noise
    found = find_candidates(bars.astype(np.float32).clip(0) + 0.2)
    sides = [np.hypot(*one.lattice.basis.T) for one in found]
    assert all(side.max() < 5 * side.min() for side in sides)


def test_other_tones_of_a_large_flat_are_not_searched_at_full_size_again(monkeypatch):
    names = [one.name for one in fields(Evidence) if one.default is MISSING]
    doubted = Evidence(**dict.fromkeys(names, 0.0))
    lattice = Lattice(np.zeros(2), 20.0 * np.eye(2), (1000, 800), 10.0)
    sizes = []

    def refuse(features, *_, **__):
        sizes.append(features.picture.shape)
        return [search.Candidate(lattice, doubted, features, None)]

    monkeypatch.setattr(search, "_search", refuse)
    picture = np.random.default_rng(0).random((1600, 2000)).astype(np.float32)
    find_candidates(picture)
    assert sizes == [(800, 1000), (1600, 2000)]
    find_candidates(picture, again=True)
    assert sizes[2:] == [(800, 1000)]


def test_half_a_cell_away_parallax_and_circles_are_fewer(house):
    found = find_candidates(sqrt_luminance(house.flat), thorough=True)
    pitch = house.camera.lattice.pitch
    same = [one for one in found if abs(one.lattice.pitch / pitch - 1) < 0.01]
    best, *others = sorted(same, key=lambda one: -one.evidence.rank)
    assert best.evidence.probability > 0.9
    assert all(one.evidence.parallax < best.evidence.parallax for one in others)
    assert all(one.evidence.circles < best.evidence.circles for one in others)


def test_a_hint_leaves_the_probability_as_it_is(whites):
    image, _ = whites.white_image(whites.turned(whites.HEXAGON, 20.3, 3), (280, 220))
    plain = lfcal.calibrate(image)
    hinted = lfcal.calibrate(image, pitch=20.0)
    assert hinted.confidence == plain.confidence
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(image, pitch=33.0)


def test_evidence_is_kept_in_the_camera_file(whites, tmp_path):
    image, _ = whites.white_image(whites.turned(whites.SQUARE, 20.3, 3), (400, 320))
    camera = lfcal.calibrate(image)
    camera.save(tmp_path / "camera.json")
    assert lfcal.load(tmp_path / "camera.json").evidence == camera.evidence
