import functools
from dataclasses import replace

import numpy as np
import pytest

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import compare_pictures, resample
from lfcal import Calibration, CalibrationError, Lattice
from lfcal.gain.gain_map import GainMap, Vignetting


@functools.cache
def capture(scene, lattice="hex", **arguments):
    camera = Camera.design(size=(420, 340), pitch=23.2, lattice=lattice, rotation=1.3)
    return simulate(SCENES[scene](camera, **arguments), camera, samples=24, seed=2)


def against_reference(shot, picture):
    """PSNR [dB] over the inner part of the picture."""
    truth = shot.truth
    shape = picture.image.shape[:2]
    wanted, inside = resample(truth.reference, truth.reference_affine, shape, picture.affine)
    inner = np.zeros(shape, bool)
    inner[20:-20, 20:-20] = True
    return compare_pictures(
        picture.image, (wanted * 255).round().astype(np.uint8), inside & inner & picture.valid
    ).psnr


@pytest.mark.parametrize("ratio", [-0.35, 0.35])
def test_fixed_patch_picture_is_sharp_in_its_own_mode_only(ratio):
    shot = capture("plane", ratio=ratio)
    s = ratio * shot.truth.calibration.lattice.pitch
    right = lfrender.render(shot.flat, shot.truth.calibration, patch_size=s)
    wrong = lfrender.render(shot.flat, shot.truth.calibration, patch_size=-s)
    assert right.scale == pytest.approx(abs(s))
    assert against_reference(shot, right) > against_reference(shot, wrong) + 4


def test_all_in_focus_beats_both_fixed_patch_pictures_of_a_scene_with_both_modes(house):
    calibration = house.truth.calibration
    s = 0.3 * calibration.lattice.pitch
    sharp = against_reference(house, lfrender.render(house.flat, calibration, scale=s))
    assert (
        sharp > against_reference(house, lfrender.render(house.flat, calibration, patch_size=s)) + 3
    )
    assert (
        sharp
        > against_reference(house, lfrender.render(house.flat, calibration, patch_size=-s)) + 3
    )


def test_scene_points_lie_where_the_affine_says():
    shot = capture("plane", ratio=-0.3)
    for scale in (3.0, 7.0, 11.0):
        picture = lfrender.render(shot.flat, shot.truth.calibration, scale=scale)
        assert picture.affine[0, 0] == pytest.approx(shot.truth.calibration.lattice.pitch / scale)
        assert against_reference(shot, picture) > 22


def test_the_picture_reaches_the_border():
    shot = capture("plane", ratio=0.3)
    picture = lfrender.render(shot.flat, shot.truth.calibration)
    assert picture.valid.mean() > 0.995
    corners = (
        np.array([[0, 0, 1], [picture.image.shape[1] - 1, picture.image.shape[0] - 1, 1]])
        @ picture.affine.T
    )
    assert (corners[0] < 23.2).all()
    assert (corners[1] > np.array([420, 340]) - 23.2).all()


def test_places_without_a_lens_are_masked():
    shot = capture("plane", ratio=0.3)
    lattice = shot.truth.calibration.lattice
    narrow = Calibration(Lattice(lattice.origin, lattice.basis, lattice.image_size, 3.0))
    picture = lfrender.render(shot.flat, narrow, patch_size=0.3 * lattice.pitch)
    assert not picture.valid.all()
    assert (picture.image[~picture.valid] == 0).all()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_the_picture_has_the_type_and_channels_of_the_flat(dtype):
    shot = capture("plane", ratio=-0.3)
    factor = {np.uint8: 1, np.uint16: 257, np.float32: 1 / 255}[dtype]
    flat = (shot.flat * float(factor)).astype(dtype)
    for pixels in (flat, flat[:, :, 0]):
        picture = lfrender.render(pixels, shot.truth.calibration, patch_size=-7)
        assert picture.image.dtype == dtype
        assert picture.image.ndim == pixels.ndim
        inside = picture.image[picture.valid].mean() / factor
        assert inside == pytest.approx(flat.mean() / factor, rel=0.5)


def test_a_uniform_flat_gives_a_uniform_picture_without_lattice():
    camera = Camera.design(size=(420, 340), pitch=23.2, rotation=1.3)
    lattice = camera.lattice
    profile = Vignetting(1 - 0.5 * np.linspace(0, 1, 30) ** 4, lattice.radius / 29)
    y, x = np.mgrid[:340, :420]
    index = lattice.to_index(np.stack([x, y], -1).reshape(-1, 2))
    delta = (index - np.rint(index)) @ lattice.basis
    flat = (40000 * profile.at(np.hypot(*delta.T)).reshape(y.shape)).astype(np.uint16)
    for s in (-7.0, 7.0, 4.4):
        picture = lfrender.render(flat, Calibration(lattice, profile), patch_size=s, blend=True)
        inner = picture.image[10:-10, 10:-10]
        assert inner.mean() == pytest.approx(40000, rel=0.01)
        assert inner.std() / inner.mean() < 0.01


def test_traditional_picture_has_one_pixel_per_microlens():
    shot = capture("ramp")
    picture = lfrender.traditional(shot.flat, shot.truth.calibration)
    assert picture.scale == 1
    assert picture.image.shape[:2] == (round(340 / 23.2), round(420 / 23.2))
    assert against_reference_of_any_size(shot, picture) < 0.03


def against_reference_of_any_size(shot, picture):
    """RMS difference, white = 1, inside the border row."""
    truth = shot.truth
    wanted, _ = resample(
        truth.reference, truth.reference_affine, picture.image.shape[:2], picture.affine
    )
    found = picture.image / 255.0
    inner = np.s_[1:-1, 1:-1]
    gain = (wanted[inner] * found[inner]).sum() / (found[inner] ** 2).sum()
    return float(np.sqrt(np.mean((found[inner] * gain - wanted[inner]) ** 2)))


def test_wrong_arguments_are_refused_with_the_reason():
    shot = capture("plane", ratio=-0.3)
    calibration = shot.truth.calibration
    depth = lfrender.analyze(shot.flat, calibration)
    with pytest.raises(ValueError, match="either depth or patch_size"):
        lfrender.render(shot.flat, calibration, depth, patch_size=5)
    for bad in (0.0, 30.0, float("nan")):
        with pytest.raises(ValueError, match="patch_size"):
            lfrender.render(shot.flat, calibration, patch_size=bad)
    for bad in (0.0, -3.0, 1e6, float("inf")):
        with pytest.raises(ValueError, match="scale"):
            lfrender.render(shot.flat, calibration, depth, scale=bad)
    other = capture("plane", "square", ratio=-0.3).truth.calibration
    with pytest.raises(CalibrationError, match="another camera"):
        lfrender.render(shot.flat, other, depth)


@pytest.mark.parametrize(("lattice", "ratio"), [("hex", -0.41), ("square", 0.28)])
@pytest.mark.parametrize(
    "profile", [None, Vignetting(np.linspace(1.0, 0.7, 14), 1.0)], ids=["even", "vignetting"]
)
def test_fixed_patches_give_the_picture_of_the_nearest_lenses(ratio, lattice, profile):
    shot = capture("plane", lattice, ratio=ratio)
    calibration = replace(shot.truth.calibration, vignetting=profile)
    s = ratio * calibration.lattice.pitch
    quick = lfrender.render(shot.flat, calibration, patch_size=s)
    # At any other scale the general kernel draws.
    general = lfrender.render(shot.flat, calibration, patch_size=s, scale=abs(s) * (1 + 1e-7))
    assert quick.image.shape == general.image.shape
    assert (quick.valid == general.valid).all()
    difference = np.abs(quick.image.astype(int) - general.image)
    # Weights are 256ths and gains tabulated; points half-way between two lenses may be read from
    # either.
    assert difference.mean() < 0.12
    assert abs((quick.image.astype(int) - general.image).mean()) < 0.02
    assert (difference > 1).mean() < 0.004
    assert difference.max() <= 6


def test_a_part_has_the_bits_of_the_whole_picture():
    shot = capture("house")
    calibration = shot.truth.calibration
    depth = lfrender.analyze(shot.flat, calibration)
    whole = lfrender.render(shot.flat, calibration, depth, scale=6.0)
    part = lfrender.render(shot.flat, calibration, depth, scale=6.0, roi=(100, 60, 300, 200))
    (left, top), (rows, columns) = (
        np.rint((part.affine[:, 2] - whole.affine[:, 2]) / whole.affine[0, 0]).astype(int),
        (part.image.shape[:2]),
    )
    np.testing.assert_array_equal(part.image, whole.image[top : top + rows, left : left + columns])
    corners = part.affine @ [[0, columns - 1], [0, rows - 1], [1, 1]]
    assert (corners[:, 0] >= (100, 60)).all() and (corners[:, 1] <= (300, 200)).all()
    assert (corners[:, 1] - corners[:, 0] > (190, 130)).all()
    alone = lfrender.render(shot.flat, calibration, scale=6.0, roi=(100, 60, 300, 200))
    assert np.abs(alone.image.astype(int) - part.image).mean() < 2
    for bad in ((900, 0, 950, 50), (0, 0, float("nan"), 9)):
        with pytest.raises(ValueError, match="roi"):
            lfrender.render(shot.flat, calibration, depth, roi=bad)


def test_flat_without_any_depth_is_drawn_at_a_pixel_per_lens_and_that_is_said():
    camera = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (400, 300), 9))
    flat = np.full((300, 400), 100, np.uint8)
    depth = lfrender.analyze(flat, camera)
    with pytest.warns(UserWarning, match="form a surface"):
        picture = lfrender.render(flat, camera, depth)
    assert picture.scale == 1 and picture.image.shape == (15, 20)
    assert lfrender.render(flat, camera, depth, scale=5).image.shape == (75, 100)


def test_junk_of_an_unfocused_capture_is_not_drawn_in_focus(shared):
    flat = lfcal.read_flat(shared("captures", "Letters.png"))[400:, 400:].copy()
    with pytest.warns(UserWarning, match="form a surface"):
        assert lfrender.render(flat, lfcal.calibrate(flat)).scale == 1


def light_of_discs(distance):
    return np.clip(9.5 - distance, 0, 1)


@pytest.mark.parametrize("light, unseen", [(np.ones_like, 0.0), (light_of_discs, 1 - np.pi / 4)])
def test_patches_reach_the_corners_of_cells_that_are_lit_up_to_there(light, unseen):
    lattice = Lattice([10, 10], [[20, 0], [0, 20]], (400, 300), 9.5)
    gain = GainMap.round(light(np.arange(80) * 0.25), 0.25, 9.5)
    rng = np.random.default_rng(3)
    flat = rng.integers(50, 200, (300, 400)).astype(np.uint8)
    for blend in (True, False):
        picture = lfrender.render(
            flat, Calibration(lattice, gain_map=gain), patch_size=19.0, blend=blend
        )
        inner = picture.valid[20:-20, 20:-20]
        assert 1 - inner.mean() == pytest.approx(unseen, abs=0.04)
        black = picture.image[20:-20, 20:-20] == 0
        assert black.mean() == pytest.approx(unseen, abs=0.04)
