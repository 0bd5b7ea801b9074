"""Gain map, flattening, usable radius and defects against white images of known light."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.ndimage import gaussian_filter

import lfcal
from lfcal.cli.main import main
from lfcal.gain.gain_map import GainMap
from lfcal.illumination.residuals import draw_sample
from lfcal.illumination.scene_profile import fit_scene_profile
from lfcal.lattice.lattice import Lattice


@pytest.fixture(scope="module")
def whole(drawn):
    truth = drawn("hexagonal", 20.3, 5.0, 26.0, size=(800, 600), hot=40)
    return truth, lfcal.calibrate(truth.image(), kind="white")


def _inside(truth, camera, margin):
    """Pixels of whole uncut discs, at least `margin` px off the rim."""
    y, x = np.mgrid[: truth.size[1], : truth.size[0]]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    far = np.hypot(*(points - truth.centres(truth.index_of(points))).T)
    return (far < truth.fill * truth.pitch / 2 - margin).reshape(x.shape) & np.isfinite(camera.gain())


def test_gain_is_the_light_to_half_a_percent(whole):
    truth, camera = whole
    inside = _inside(truth, camera, 1.5)
    ratio = camera.gain()[inside] / truth.light()[inside]
    assert inside.mean() > 0.55
    assert (ratio / ratio.mean()).std() < 0.005
    assert 0.95 < np.nanmax(camera.gain()) < 1.05


def test_gain_of_cut_microimages_is_theirs(drawn):
    truth = drawn("hexagonal", 20.3, 5.0, 26.0, strength=0.3, size=(800, 600))
    camera = lfcal.calibrate(truth.image(), kind="white")
    light, gain = truth.light(), camera.gain()
    lit = np.isfinite(gain) & (light > 0.5)
    ratio = gain[lit] / light[lit]
    assert (np.abs(ratio / np.median(ratio) - 1) < 0.05).mean() > 0.97
    assert np.isnan(gain[light < 0.1]).mean() > 0.99
    usable = camera.usable_radius()
    middle = np.hypot(*(camera.lattice.centres() - truth.middle).T) < 0.2 * truth.reach
    corner = np.hypot(*(camera.lattice.centres() - truth.middle).T) > 0.9 * truth.reach
    assert usable[corner].mean() < 0.85 * usable[middle].mean()


def test_flattened_white_image_is_even_and_keeps_its_type(drawn, whole):
    truth, camera = whole
    inside = _inside(truth, camera, 1.5)
    clean = np.rint(40000 * truth.light()).astype(np.uint16)
    even = camera.flatten(clean)
    assert even.dtype == np.uint16 and even.shape == clean.shape
    assert even[inside].std() / even[inside].mean() < 0.005 < 0.05 < clean[inside].std() / clean[inside].mean()
    unknown = np.isnan(camera.gain())
    np.testing.assert_array_equal(even[unknown], clean[unknown])
    colour = camera.flatten(np.repeat(clean[..., None], 3, axis=2).astype(np.float32))
    np.testing.assert_allclose(colour[inside, 2], even[inside], atol=0.51)
    with pytest.raises(lfcal.FlatError, match="800 x 600"):
        camera.flatten(clean[1:])


def test_integers_are_clipped_at_the_top(whole):
    truth, camera = whole
    even = camera.flatten(np.full((truth.size[1], truth.size[0]), 255, np.uint8))
    assert even[np.isfinite(camera.gain())].min() >= 254


def test_hot_pixels_are_found_and_noise_is_not(whole):
    truth, camera = whole
    rng = np.random.default_rng(truth.seed + 1)
    rng.standard_normal(truth.size[::-1])
    rows, columns = rng.integers(0, truth.size[1], 40), rng.integers(0, truth.size[0], 40)
    hot = {(x, y) for x, y in zip(columns.tolist(), rows.tolist(), strict=True)}
    found = {(x, y) for x, y in camera.defects.pixels.tolist()}
    assert len(found & hot) >= 0.95 * len(hot)
    assert len(found - hot) <= 8


def test_missing_lens_is_told_and_has_no_gain(drawn):
    truth = drawn("square", 24.0, 2.0, 30.0, size=(700, 500))
    image = truth.image()
    index = truth.index_of(np.array([[350.0, 250.0]]))
    x, y = np.rint(truth.centres(index)[0]).astype(int)
    image[y - 12 : y + 13, x - 12 : x + 13] = image.min()
    camera = lfcal.calibrate(image, kind="white")
    lenses = camera.defects.lenses
    assert len(lenses) == 1
    np.testing.assert_allclose(camera.lattice.points(lenses)[0], (x, y), atol=1)
    assert np.isnan(camera.gain()[y - 8 : y + 9, x - 8 : x + 9]).all()
    assert (camera.usable_radius() == 0).sum() == 1


def test_gain_map_and_defects_survive_the_file(whole, tmp_path):
    _, camera = whole
    camera.save(tmp_path / "camera.json")
    back = lfcal.load(tmp_path / "camera.json")
    np.testing.assert_array_equal(back.defects.pixels, camera.defects.pixels)
    np.testing.assert_allclose(back.gain(), camera.gain(), rtol=2e-3)
    assert (tmp_path / "camera.json").stat().st_size < 30000
    data = json.loads((tmp_path / "camera.json").read_text())
    data["gain_map"]["profile"] = "x"
    with pytest.raises(lfcal.CameraFileError):
        lfcal.Calibration.from_dict(data)


def test_camera_without_any_light_says_so():
    camera = lfcal.Calibration(lfcal.Lattice((10, 10), np.eye(2) * 20, (100, 80), 9.0))
    with pytest.raises(lfcal.CalibrationError, match="gain map"):
        camera.gain()


def test_command_writes_the_flattened_flat(whole, tmp_path):
    import cv2

    truth, camera = whole
    camera.save(tmp_path / "camera.json")
    image = truth.image()
    cv2.imwrite(str(tmp_path / "flat.png"), image)
    arguments = ["flatten", str(tmp_path / "flat.png"), "-c", str(tmp_path / "camera.json")]
    result = CliRunner().invoke(main, [*arguments, "-o", str(tmp_path / "even.tif")], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    written = lfcal.read_flat(tmp_path / "even.tif")
    np.testing.assert_array_equal(written, lfcal.load(tmp_path / "camera.json").flatten(image))


def test_result_does_not_depend_on_the_number_of_threads(drawn):
    import numba

    from lfcal.illumination.measure import measure_illumination
    from lfcal.images.preprocessing import sqrt_luminance

    truth = drawn("hexagonal", 14.3, 3.0, 26.0, size=(500, 400), hot=20, dust=4)
    lattice = lfcal.Lattice(truth.origin, truth.basis, truth.size, 7.0)
    picture = sqrt_luminance(truth.image())
    before = numba.get_num_threads()
    found = []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS), 1):
            numba.set_num_threads(threads)
            found.append(measure_illumination(picture, lattice, white=True))
    finally:
        numba.set_num_threads(before)
    for other in found[1:]:
        assert json.dumps(other.gain_map.to_dict()) == json.dumps(found[0].gain_map.to_dict())
        np.testing.assert_array_equal(other.gain_map.level, found[0].gain_map.level)
        np.testing.assert_array_equal(other.gain_map.gain(lattice), found[0].gain_map.gain(lattice))
        np.testing.assert_array_equal(other.defects.pixels, found[0].defects.pixels)
    assert len(found[0].defects.pixels) > 20


def test_scene_with_much_contrast_gives_the_profile_to_a_percent():
    """Blobs of light 2 to 6 px wide, each microimage its own: levels of lenses differ by more than half."""
    from lfcal.illumination.measure import measure_illumination
    from lfcal.images.preprocessing import sqrt_luminance

    rng = np.random.default_rng(5)
    size, radius = (1000, 800), 9.0
    lattice = lfcal.Lattice((9.3, 11.8), np.array([[20.4, 0.7], [9.6, 17.9]]), size, radius)
    y, x = np.mgrid[: size[1], : size[0]].astype(np.float32)
    import cv2

    scene = np.exp(3 * cv2.GaussianBlur(rng.standard_normal((size[1], size[0])), (0, 0), 4) / 0.07 * 0.25)
    points = np.column_stack([x.ravel(), y.ravel()])
    index = np.rint(lattice.to_index(points))
    far = np.full(len(points), np.inf)
    for step in [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]:
        far = np.minimum(far, np.hypot(*(points - lattice.points(index + step)).T))
    light = (np.clip(radius + 0.5 - far, 0.05, 1) * (1 - 0.1 * (far / radius) ** 2)).reshape(x.shape)
    seen = measure_illumination(sqrt_luminance(scene * light), lattice, white=False)
    gain = seen.gain_map.gain(lattice)
    core = far.reshape(x.shape) < 0.9 * radius
    ratio = gain[core] / light[core]
    assert ratio.std() / ratio.mean() < 0.01
    outer = far.reshape(x.shape)[core] > 0.75 * radius
    assert abs(ratio[outer].mean() / ratio[~outer].mean() - 1) < 0.01


def test_dust_is_no_light_of_its_lens(drawn):
    truth = drawn("hexagonal", 20.3, 5.0, 26.0, size=(800, 600))
    image = truth.image()
    y, x = np.mgrid[: truth.size[1], : truth.size[0]]
    cx, cy = truth.centres(truth.index_of(np.array([[400.0, 300.0]])))[0] + (4, 2)
    specks = 1 - 0.6 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * 4.0**2))
    camera = lfcal.calibrate((image * specks).astype(image.dtype), kind="white")
    found = camera.defects.pixels
    dust = specks < 0.99
    assert np.mean(~dust[found[:, 1], found[:, 0]] * (np.hypot(*(found - (cx, cy)).T) < 40)) < 0.01
    deep = np.zeros(dust.shape, bool)
    deep[found[:, 1], found[:, 0]] = True
    assert deep[(specks < 0.8) & (truth.light() > 0.5)].mean() > 0.9


def test_generally_distorted_lattice_is_followed_by_the_gain():
    from lfcal.gain.gain_map import GainMap
    from lfcal.lattice.distortion import Distortion

    size = (300, 240)
    general = np.zeros((2, 7))
    general[0, 2], general[1, 0] = 6.0, -5.0
    bend = Distortion(np.array([150.0, 120.0]), 0.01, 0.0, 192.0, general, np.array([150.0, 120.0]))
    lattice = lfcal.Lattice((12.0, 9.0), np.array([[15.2, 0.4], [7.2, 13.3]]), size, 7.0, bend)
    profile = np.linspace(1.0, 0.3, 64)
    gain = GainMap.round(profile, 0.25, 7.0).gain(lattice)
    y, x = np.mgrid[: size[1], : size[0]]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    i, j = np.meshgrid(np.arange(-20, 40), np.arange(-10, 40))
    centres = lattice.points(np.column_stack([i.ravel(), j.ravel()]))
    far = np.full(len(points), np.inf)
    for centre in centres[((centres > -20) & (centres < np.array(size) + 20)).all(1)]:
        far = np.minimum(far, np.hypot(*(points - centre).T))
    expected = np.interp(far, np.arange(64) * 0.25, profile).reshape(gain.shape)
    np.testing.assert_allclose(gain, expected, atol=1e-6)


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_scene_puts_no_spot_into_the_middle_of_microimages(seed):
    lattice = Lattice((201.3, 160.2), ((46.0, 0.8), (22.2, 39.9)), (420, 340), 20.0)
    scene = gaussian_filter(np.random.default_rng(seed).normal(0, 1, (340, 420)), 3.0)
    picture = (0.5 + 0.12 * scene / scene.std()).clip(0.05, 1).astype(np.float32)
    profile = fit_scene_profile(picture, lattice, GainMap.round(np.ones(100), 0.25, 20.0), np.inf)
    # Pixel by pixel, the few in the middle of these 80 lenses are up to 40 % off.
    np.testing.assert_allclose(profile[:6] / np.median(profile[:60]), 1, atol=0.06)


def test_some_lenses_of_a_sample_stay_in_their_windows():
    sample = draw_sample(Lattice([3.0, 2.0], [[12.1, 0.2], [5.9, 10.4]], (900, 700), 5.0), 1e6)
    some = sample.some(3)
    assert some.shape == sample.shape and len(some.centres) == some.first[-1]
    assert len(some.centres) == pytest.approx(len(sample.centres) / 3, abs=1)
    for number in range(len(sample.first) - 1):
        own, fewer = (of.centres[of.first[number] : of.first[number + 1]].tolist() for of in (sample, some))
        assert len(fewer) == pytest.approx(len(own) / 3, abs=1) and all(centre in own for centre in fewer)
