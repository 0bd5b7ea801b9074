"""The depth analysis of simulated flats against their truth."""

import functools
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from lfcal import Calibration, CalibrationError, FlatError, Lattice, read_flat


@functools.cache
def capture(scene, lattice="hex", pitch=23.2, size=(420, 340), noise=None, **arguments):
    camera = Camera.design(size=size, pitch=pitch, lattice=lattice, rotation=1.3)
    return simulate(SCENES[scene](camera, **arguments), camera, samples=16, seed=2, noise=noise)


def errors(shot, depth):
    """Absolute errors of s [px] of the lenses that truly have one resolvable depth."""
    truth = shot.truth
    return np.abs(depth.patch_size - truth.patch_size)[(truth.mode != 0) & ~truth.mixed]


@pytest.mark.parametrize(
    ("lattice", "ratio"),
    [("hex", -0.5), ("hex", 0.2), ("hex-vertical", 0.5), ("square", -0.2), ("square", 0.5)],
)
def test_mode_and_patch_size_of_a_plane_are_found_on_every_lattice(lattice, ratio):
    shot = capture("plane", lattice, ratio=ratio)
    depth = lfrender.analyze(shot.flat, shot.truth.calibration)
    resolved = depth.mode != 0
    assert (depth.mode[resolved] == np.sign(ratio)).mean() > 0.99
    assert resolved.mean() > 0.95
    assert np.nanmedian(errors(shot, depth)) < 0.03
    np.testing.assert_allclose(np.nanmedian(depth.magnification), 1 / abs(ratio), rtol=0.02)


def test_both_modes_in_one_flat_are_distinguished(house):
    depth = lfrender.analyze(house.flat, house.truth.calibration)
    truth = house.truth
    single = (truth.mode != 0) & ~truth.mixed
    assert (depth.mode == truth.mode)[single].mean() > 0.98
    # A fifth of the lenses sees several depths.
    assert (depth.mode == truth.mode)[truth.mode != 0].mean() > 0.75


@pytest.mark.parametrize("preset", ["fast", "balanced"])
def test_every_preset_finds_the_mode(preset):
    shot = capture("plane", ratio=-0.3)
    depth = lfrender.analyze(shot.flat, shot.truth.calibration, preset)
    assert (depth.mode == -1).mean() > 0.98
    assert depth.preset == preset


def test_a_blank_wall_is_unresolved_with_low_confidence():
    shot = capture("blank", noise=(2000, 5))
    depth = lfrender.analyze(shot.flat, shot.truth.calibration)
    assert (depth.mode == 0).mean() > 0.99
    assert (depth.confidence > 0.5).mean() < 0.01
    assert depth.filled.mean() > 0.99
    assert np.isfinite(depth.filled_patch_size).all()


def test_shading_inside_microimages_is_not_taken_for_a_plane_at_zero_disparity():
    shot = capture("blank")
    calibration = shot.truth.calibration
    y, x = np.mgrid[: shot.flat.shape[0], : shot.flat.shape[1]]
    index = calibration.lattice.to_index(np.stack([x, y], -1).reshape(-1, 2))
    delta = (index - np.rint(index)) @ calibration.lattice.basis
    bump = 1 - 0.04 * np.exp(-(delta**2).sum(1) / 20).reshape(y.shape)
    flat = np.rint(shot.flat * bump[..., None]).astype(np.uint8)
    depth = lfrender.analyze(flat, calibration)
    assert (depth.mode == 0).mean() > 0.9


@pytest.mark.parametrize(
    ("quality", "resolved", "confident"), [(None, 0, 0), (90, 0.12, 0.09), (20, 0.2, 0.04)]
)
def test_residual_mechanical_vignetting_is_not_taken_for_texture(quality, resolved, confident):
    shot = capture("plane", ratio=0.45)
    calibration = shot.truth.calibration
    y, x = np.mgrid[: shot.flat.shape[0], : shot.flat.shape[1]]
    index = calibration.lattice.to_index(np.stack([x, y], -1).reshape(-1, 2))
    delta = (index - np.rint(index)) @ calibration.lattice.basis
    above = -delta[:, 1].reshape(y.shape) / calibration.lattice.pitch
    light = calibration.vignetting.at(np.hypot(*delta.T)).reshape(y.shape)
    dark = 48 * np.clip(1 - y / 50, 0, 1) * np.clip(above - 0.1, 0, None)
    upper = calibration.lattice.centres()[:, 1] < 60
    reasons = []
    sure = []
    for seed in range(3, 9):
        noise = np.random.default_rng(seed).normal(0, 2, (*y.shape, 1))
        wall = ((30 - dark) * np.maximum(light, 0.9))[..., None] + noise
        flat = np.where(y[..., None] > 170, shot.flat, wall).round().clip(0, 255).astype(np.uint8)
        if quality is not None:
            # JPEG replaces noise by blocks.
            coded = cv2.imencode(".jpg", flat, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            flat = cv2.imdecode(coded, cv2.IMREAD_COLOR)
        depth = lfrender.analyze(flat, calibration)
        reasons.append(depth.reason[upper])
        sure.append(depth.confidence[upper] > 0.5)
    assert np.mean(np.equal(reasons, 0)) <= resolved
    assert np.mean(sure) <= confident


def test_faint_texture_at_a_small_disparity_is_resolved():
    shot = capture("plane", ratio=-0.1)
    noise = np.random.default_rng(0).normal(0, 1, shot.flat.shape)
    faint = (100 + 0.08 * (shot.flat - shot.flat.mean()) + noise).round().astype(np.uint8)
    depth = lfrender.analyze(faint, shot.truth.calibration)
    assert (depth.mode == -1).mean() > 0.9


def test_a_dark_flat_is_resolved():
    shot = capture("plane", ratio=0.3)
    dark = (shot.flat / 255.0 * 0.04).astype(np.float32)
    depth = lfrender.analyze(dark, shot.truth.calibration)
    assert (depth.mode == 1).mean() > 0.95
    assert np.nanmedian(errors(shot, depth)) < 0.05


def test_large_patch_sizes_are_not_biased_toward_zero():
    shot = capture("plane", ratio=-0.6, noise=(4000, 5))
    depth = lfrender.analyze(shot.flat, shot.truth.calibration)
    assert (depth.mode == -1).mean() > 0.97
    assert abs(np.nanmedian(depth.patch_size) + 0.6 * 23.2) < 0.05
    assert np.nanquantile(errors(shot, depth), 0.95) < 0.3


def test_half_the_exposure_and_more_bits_change_less_than_a_tenth_of_a_pixel():
    shot = capture("plane", ratio=0.3)
    calibration = shot.truth.calibration
    first = lfrender.analyze(shot.flat, calibration)
    for flat in (shot.flat.astype(np.uint16) * 128, shot.flat / 255.0):
        other = lfrender.analyze(flat, calibration)
        both = (first.mode != 0) & (other.mode != 0)
        assert both.mean() > 0.95
        assert np.abs(first.patch_size - other.patch_size)[both].max() < 0.1


def test_mono_and_colour_with_equal_channels_agree():
    shot = capture("plane", ratio=-0.3)
    mono = shot.flat[:, :, 1]
    first = lfrender.analyze(mono, shot.truth.calibration)
    second = lfrender.analyze(np.repeat(mono[:, :, None], 3, 2), shot.truth.calibration)
    np.testing.assert_allclose(first.filled_patch_size, second.filled_patch_size, atol=1e-3)


def test_points_half_a_pitch_from_a_depth_edge_have_the_right_depth(house):
    depth = lfrender.analyze(house.flat, house.truth.calibration)
    truth = house.truth
    wanted = truth.reference_patch_size
    v, u = np.mgrid[: wanted.shape[0], : wanted.shape[1]]
    points = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ truth.reference_affine.T
    found = depth.surface.at(points).reshape(wanted.shape)
    side = 1 + 2 * int(0.5 * depth.pitch / truth.reference_affine[0, 0])
    even = maximum_filter(wanted, side) - minimum_filter(wanted, side) < 2
    even[:side] = even[-side:] = even[:, :side] = even[:, -side:] = False
    assert even.mean() > 0.05
    assert (np.abs(found - wanted)[even] < 1).mean() > 0.95


def test_invalid_input_raises_an_error_that_names_it():
    shot = capture("plane", ratio=-0.3)
    calibration = shot.truth.calibration
    with pytest.raises(CalibrationError, match="420 x 340"):
        lfrender.analyze(shot.flat[:100], calibration)
    with pytest.raises(ValueError, match="preset"):
        lfrender.analyze(shot.flat, calibration, "best")
    broken = shot.flat.astype(np.float32)
    broken[7, 5, 0] = np.nan
    with pytest.raises(FlatError, match="x=5, y=7"):
        lfrender.analyze(broken, calibration)
    with pytest.raises(FlatError, match="shape"):
        lfrender.analyze(shot.flat[None], calibration)


def test_flats_of_12_bits_in_16_bit_files_give_the_depth_of_8_bits(house, house_camera, bits=12):
    wide = house.flat.astype(np.uint16) << (bits - 8)
    camera = lfcal.calibrate(wide)
    camera_of_bytes = house_camera
    assert (camera.white_level, camera_of_bytes.white_level) == (2.0**bits - 1, None)
    depth = lfrender.analyze(wide, camera)
    depth_of_bytes = lfrender.analyze(house.flat, camera_of_bytes)
    assert (depth.mode == depth_of_bytes.mode).mean() > 0.99
    known = (depth.mode != 0) & (depth_of_bytes.mode != 0)
    assert np.abs(depth.patch_size - depth_of_bytes.patch_size)[known].max() < 0.05
    scale = depth_of_bytes.pitch / 3
    picture = lfrender.render(wide, camera, depth_of_bytes, scale=scale).image / 2.0 ** (bits - 8)
    picture_of_bytes = lfrender.render(
        house.flat, camera_of_bytes, depth_of_bytes, scale=scale
    ).image
    assert np.abs(picture - picture_of_bytes).mean() < 1.0


def test_floats_above_white_raise_an_error(house):
    camera = house.truth.calibration
    with pytest.raises(FlatError, match="divide it"):
        lfrender.analyze(house.flat.astype(np.float32), camera)


@pytest.mark.parametrize(
    "name",
    [
        "s3_r5",
        "s2_sq",
        *(pytest.param(n, marks=pytest.mark.nightly) for n in ("s4b_tspc", "s5b_tspc")),
    ],
)
def test_flats_of_another_simulator_agree_with_their_truth(shared, name):
    camera = json.loads(shared("truth", name, "truth.json").read_text())["camera"]
    radius = camera["microimage_aperture_px"] / 2
    lattice = Lattice(camera["origin_px"], camera["basis_px"], (camera["W"], camera["H"]), radius)
    depth = lfrender.analyze(read_flat(shared("truth", name, "flat.png")), Calibration(lattice))
    truth = np.load(shared("truth", name, "microlenses.npz"))
    order = _order(lattice, truth["centre_px"])
    mode = truth["mode"][order]
    s = truth["disparity_px"][order]
    single = (mode != 0) & ~truth["mixed"][order].astype(bool)
    error = np.abs(depth.patch_size - s)[single]
    assert (depth.mode == mode)[single].mean() > 0.995
    assert np.nanmedian(error) < 0.02
    assert np.nanquantile(error, 0.95) < 0.35
    if name in ("s2_sq", "s4b_tspc"):
        # All lenses of a plane share its error, so that no share of them lies within it.
        assert np.nanquantile(error, 0.99) < 0.05
        assert np.nanmedian(error / depth.standard_error[single]) < 2
    else:
        assert 0.5 < (error < depth.standard_error[single]).mean() < 0.9


def _order(lattice, points):
    """Row of `points` nearest to each centre."""
    from scipy.spatial import cKDTree

    return cKDTree(points).query(lattice.centres())[1]


def test_only_the_region_of_interest_is_analysed(house):
    calibration = house.truth.calibration
    roi = (150.0, 100.0, 330.0, 280.0)
    centres = calibration.lattice.centres()
    inside = ((centres >= roi[:2]) & (centres <= roi[2:])).all(1)
    full = lfrender.analyze(house.flat, calibration)
    part = lfrender.analyze(house.flat, calibration, roi=roi)
    assert (part.reason[~inside] == 4).all()
    assert (part.confidence[~inside] == 0).all()
    assert np.isnan(part.patch_size[~inside]).all()
    assert part.saved["roi"] == pytest.approx(1 - inside.mean())
    deep = inside & (part.mode != 0) & (full.mode != 0)
    assert deep.sum() > 0.8 * inside.sum()
    assert np.quantile(np.abs(full.patch_size - part.patch_size)[deep], 0.9) < 0.05
    at = centres[inside]
    assert np.quantile(np.abs(full.surface.at(at) - part.surface.at(at)), 0.9) < 0.1


@pytest.mark.parametrize(
    "roi", [(5, 5, 1, 9), (0, 0, np.nan, 9), (900, 900, 950, 950), (3, 3, 5, 5), (1, 2, 3), "abcd"]
)
def test_invalid_or_empty_regions_raise_an_error(house, roi):
    with pytest.raises(ValueError, match="roi"):
        lfrender.analyze(house.flat, house.truth.calibration, roi=roi)


def test_rounding_errors_of_a_lattice_change_no_surface():
    camera = Camera.design(size=(420, 330), pitch=20, lattice="hex")
    house = simulate(SCENES["house"](camera), camera, samples=16, seed=4)
    regular = house.truth.calibration
    expected = lfrender.analyze(house.flat, regular).surface.patch_size
    for error in (-1e-13, -1e-14, 1e-14, 1e-13):
        moved = Lattice(
            regular.lattice.origin + error,
            regular.lattice.basis * (1 + error),
            regular.lattice.image_size,
            regular.lattice.radius,
        )
        found = lfrender.analyze(house.flat, replace(regular, lattice=moved)).surface.patch_size
        np.testing.assert_allclose(found, expected, atol=1e-4)
