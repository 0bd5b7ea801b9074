"""The rendered flats against brute force: shifts between microimages, centres, occlusion, noise,
seeds.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from data_synth import SCENES, Camera, Capture, Patch, Scene, Sphere, simulate


def measured_patch_size(capture: Capture, n: int, step: tuple[int, int]) -> float:
    """Shift along the step between lens `n` and its neighbour that makes their pictures most alike,
    brute force.
    """
    camera = capture.camera
    picture = capture.flat.astype(float)[..., 1]
    centre = capture.truth.calibration.lattice.centres()[n]
    vector = np.array(step) @ np.array(camera.basis)
    radius = 0.27 * camera.pitch
    grid = np.mgrid[-radius : radius + 0.1, -radius : radius + 0.1].reshape(2, -1)[::-1].T
    grid = grid[np.hypot(*grid.T) <= radius]
    shifts = np.arange(-0.65, 0.66, 0.01) * camera.pitch
    likeness = []
    for s in shifts:
        offset = s * vector / camera.pitch / 2
        pair = [
            map_coordinates(picture, (place + grid)[:, ::-1].T, order=1)
            for place in (centre - offset, centre + vector + offset)
        ]
        inside = (np.hypot(*(grid - offset).T) < 0.44 * camera.pitch) & (
            np.hypot(*(grid + offset).T) < 0.44 * camera.pitch
        )
        if inside.sum() < 30:
            likeness.append(-1.0)
            continue
        likeness.append(np.corrcoef(pair[0][inside], pair[1][inside])[0, 1])
    return float(shifts[int(np.argmax(likeness))])


@pytest.mark.parametrize(
    ("lattice", "ratio"), [("hex", 0.353), ("hex", -0.204), ("square", 0.248), ("square", -0.397)]
)
def test_microimages_of_a_plane_shift_by_the_true_patch_size(lattice: str, ratio: float) -> None:
    camera = Camera.design((220, 220), 30.0, lattice, 5.0)
    capture = simulate(
        SCENES["plane"](camera, ratio=ratio), camera, samples=32, bits=16, gamma=False
    )
    truth = capture.truth
    centres = capture.truth.calibration.lattice.centres()
    assert truth.patch_size == pytest.approx(ratio * camera.pitch, abs=1e-9)
    inner = np.flatnonzero((np.abs(centres - 110) < 50).all(1))
    errors = [
        measured_patch_size(capture, n, step) - truth.patch_size[n]
        for n in inner
        for step in ((1, 0), (0, 1))
    ]
    assert abs(np.median(errors)) < 0.2
    assert np.median(np.abs(errors)) < 0.3
    assert (truth.mode[inner] == np.sign(ratio)).all()
    assert truth.magnification[inner] == pytest.approx(1 / abs(ratio))


def test_light_that_falls_off_within_microlenses_moves_no_feature() -> None:
    shown = {}
    for falling in (True, False):
        camera = Camera.design((300, 300), 30.0, natural_vignetting=falling)
        capture = simulate(
            SCENES["plane"](camera, ratio=-0.55), camera, samples=32, bits=16, gamma=False
        )
        shown[falling] = (
            capture.flat[..., 1].astype(float),
            capture.truth.calibration.lattice.centres(),
        )
    (dim, centres), (even, _) = shown[True], shown[False]
    moved = steep = 0.0
    for x, y in centres[(np.abs(centres - 150) < 120).all(1)]:
        # How far outward one picture lies from the other, by least squares.
        box = np.s_[round(y) - 10 : round(y) + 11, round(x) - 10 : round(x) + 11]
        v, u = np.gradient(even[box])
        rows, columns = np.mgrid[-10:11, -10:11]
        out = np.hypot(rows, columns)
        rim = (out > 6) & (out < 12)
        slope = ((u * columns + v * rows) / np.maximum(out, 1))[rim]
        ratio = (dim[box] / np.maximum(even[box], 1))[rim]
        change = dim[box][rim] - even[box][rim] * np.median(ratio)
        moved += slope @ change
        steep += slope @ slope
    assert abs(moved / steep) < 0.002, f"features move by {-moved / steep:.4f} px outward"


def test_white_microimages_are_centred_on_the_true_lattice() -> None:
    camera = Camera.design((300, 300), 24.0, "hex-vertical", 7.0)
    capture = simulate(SCENES["blank"](camera), camera, samples=64, bits=16, gamma=False)
    white = capture.white.astype(float)
    centres = capture.truth.calibration.lattice.centres()
    y, x = np.mgrid[0:300, 0:300]
    errors = []
    for c in centres[(np.abs(centres - 149.5) < 130).all(1)]:
        cell = white * (np.hypot(x - c[0], y - c[1]) < 0.5 * camera.pitch)
        errors.append([(cell * x).sum() / cell.sum() - c[0], (cell * y).sum() / cell.sum() - c[1]])
    assert len(errors) > 100
    assert np.sqrt(np.mean(np.square(errors))) < 0.02
    assert np.abs(np.mean(errors, axis=0)).max() < 0.005


def test_white_fills_the_stated_radius_and_leaves_gaps_dark() -> None:
    camera = Camera.design((200, 200), 24.0)
    capture = simulate(SCENES["blank"](camera), camera, samples=32, bits=16, gamma=False)
    y, x = np.mgrid[0:200, 0:200]
    centres = capture.truth.calibration.lattice.centres()
    distance = np.min([np.hypot(x - c[0], y - c[1]) for c in centres], axis=0)[20:-20, 20:-20]
    light = capture.white[20:-20, 20:-20] / 65535 / 0.9
    radius = capture.truth.calibration.lattice.radius
    assert light[distance < radius - 1].min() > 0.9
    assert light[distance > radius + 1.5].max() == 0
    assert light[np.abs(distance - radius) < 0.15].mean() == pytest.approx(0.5, abs=0.1)


def test_a_stop_cuts_microimages_away_from_the_principal_point() -> None:
    camera = Camera.design((160, 160), 24.0).replace(principal_point=(-600.0, 80.0))
    plain = simulate(SCENES["blank"](camera), camera, samples=4, bits=16, gamma=False)
    cut = camera.replace(stop=(25.0, camera.aperture))
    stopped = simulate(SCENES["blank"](cut), cut, samples=4, bits=16, gamma=False)
    assert stopped.white.sum() < 0.95 * plain.white.sum()
    assert not ((stopped.white > 0) & (plain.white == 0)).any()


def test_both_modes_occur_in_the_house_and_sky_has_none(house: Capture) -> None:
    truth = house.truth
    assert (truth.mode == 1).sum() > 20
    assert (truth.mode == -1).sum() > 20
    assert truth.mixed.any()
    assert not truth.mixed.all()
    assert (truth.contrast[(truth.mode == 0)] < 0.02).all()


def test_dense_truth_holds_the_lens_truth_at_the_centres(house: Capture) -> None:
    truth = house.truth
    at = np.rint(truth.calibration.lattice.centres()).astype(int)
    plain = ~truth.mixed
    dense = truth.disparity[at[:, 1], at[:, 0]]
    assert dense[plain] == pytest.approx(truth.patch_size[plain], abs=0.3)
    assert 0.1 < np.isnan(truth.disparity).mean() < 0.35


def colours_at_true_places(capture: Capture, sign: float) -> tuple[np.ndarray, np.ndarray]:
    """Green of flat pixels and of the reference at `X = c - delta * D / s`, where both see the same
    depth.
    """
    truth = capture.truth
    camera = capture.camera
    lattice = truth.calibration.lattice
    y, x = np.nonzero(np.isfinite(truth.disparity))
    pixels = np.column_stack([x, y]).astype(float)
    centres = lattice.centres()
    own = centres[np.argmin(((pixels[:, None] - centres) ** 2).sum(-1), axis=1)]
    s = truth.disparity[y, x].astype(float)
    place = own - (pixels - own) * camera.pitch / (sign * s)[:, None]
    uv = (place - truth.reference_affine[:, 2]) @ np.linalg.inv(truth.reference_affine[:, :2]).T
    at = uv[:, ::-1].T
    there = map_coordinates(truth.reference_patch_size, at, order=0, cval=np.nan)
    same = np.abs(there - s) < 0.05
    found = capture.flat[y, x, 1] / 65535
    expected = map_coordinates(truth.reference[..., 1] / 65535, at, order=1)
    return found[same], expected[same]


def test_flat_pixels_show_the_reference_at_their_true_place(house: Capture) -> None:
    found, expected = colours_at_true_places(house, 1.0)
    assert len(found) > 15000
    # The flat is blurred by pixels and microlens defocus: alike, not equal.
    assert np.corrcoef(found, expected)[0, 1] > 0.85
    assert np.corrcoef(*colours_at_true_places(house, -1.0))[0, 1] < 0.4


def test_a_nearer_surface_hides_the_farther(small_camera: Camera) -> None:
    camera = small_camera
    red = np.full((2, 2, 3), (0.8, 0, 0))
    green = np.full((2, 2, 3), (0, 0.8, 0))

    def sheet(ratio: float, left: float, colour: np.ndarray) -> Patch:
        corner, a, b = camera.place(
            [(left, -300), (700, -300), (left, 700)], camera.depth_at(ratio)
        )
        return Patch(corner, a - corner, b - corner, colour)

    far = sheet(0.3, -500, red)
    near = sheet(-0.3, 130, green)
    pictures = [
        simulate(Scene("two", pair), camera, samples=4) for pair in ((far, near), (near, far))
    ]
    assert np.array_equal(pictures[0].flat, pictures[1].flat), (
        "the order in the list does not matter"
    )
    assert near.bounds[0, 2] < far.bounds[0, 2]
    truth = pictures[0].truth
    x = truth.calibration.lattice.centres()[:, 0]
    assert truth.patch_size[x > 131] == pytest.approx(-0.3 * camera.pitch)
    assert truth.patch_size[x < 129] == pytest.approx(0.3 * camera.pitch)
    reference = truth.reference
    assert reference[60, 20, 0] > 200 > 5 > reference[60, 20, 1]
    assert reference[60, 110, 1] > 200 > 5 > reference[60, 110, 0]


def test_cut_outs_and_empty_background_have_no_surface(small_camera: Camera) -> None:
    camera = small_camera
    texture = np.zeros((1, 64, 4), np.float32)
    texture[:, :32] = 1
    corner, a, b = camera.place([(-300, -300), (560, -300), (-300, 600)], camera.depth_at(-0.3))
    patch = Patch(corner, a - corner, b - corner, texture)
    truth = simulate(Scene("half", (patch,)), camera, samples=2).truth
    x = truth.calibration.lattice.centres()[:, 0]
    assert np.isfinite(truth.patch_size[x < 128]).all()
    assert np.isnan(truth.patch_size[x > 132]).all()
    assert (truth.mode[x > 132] == 0).all()


def test_the_front_of_a_sphere_is_where_it_should_be(small_camera: Camera) -> None:
    camera = small_camera
    front = float(camera.depth_at(-0.3))
    x, y, _ = camera.place((130, 120), front + 8)
    ball = Sphere(np.array([x, y, front + 8.0]), 8.0, np.full((4, 4, 3), 0.5))
    truth = simulate(Scene("ball", (ball,)), camera, samples=1).truth
    row = 60
    column = 65
    assert truth.reference_patch_size[row, column] == pytest.approx(-0.3 * camera.pitch, abs=0.05)
    assert np.nanmax(truth.reference_patch_size) == pytest.approx(-0.3 * camera.pitch, abs=0.05), (
        "the front is nearest"
    )


def test_seeds_reproduce_bit_for_bit_and_differ_from_each_other(small_camera: Camera) -> None:
    def run(seed: int) -> Capture:
        return simulate(
            SCENES["clutter"](small_camera, seed=3),
            small_camera,
            samples=3,
            seed=seed,
            noise=(9000, 4),
        )

    first = run(5)
    again = run(5)
    other = run(6)
    assert np.array_equal(first.flat, again.flat)
    assert np.array_equal(first.white, again.white)
    assert np.array_equal(first.truth.reference, again.truth.reference)
    assert not np.array_equal(first.flat, other.flat)


def test_noise_has_the_stated_variance() -> None:
    camera = Camera.design((200, 200), 24.0, natural_vignetting=False)
    full_well = 4000.0
    read = 12.0
    scene = SCENES["blank"](camera)
    clean, noisy = (
        simulate(scene, camera, samples=4, bits=16, gamma=False, noise=noise)
        for noise in (None, (full_well, read))
    )
    lit = (clean.flat == clean.flat.max()).all(-1)
    level = clean.flat[lit] / 65535
    error = (noisy.flat[lit].astype(float) - clean.flat[lit]) / 65535
    assert level == pytest.approx(0.45, abs=1e-4)
    assert error.var() == pytest.approx(0.45 / full_well + (read / full_well) ** 2, rel=0.03)
    assert abs(error.mean()) < 1e-3


def test_more_samples_bring_the_flat_nearer_to_its_limit(small_camera: Camera) -> None:
    scene = SCENES["plane"](small_camera)
    limit, few, many = (
        simulate(scene, small_camera, samples=n, seed=seed, bits=16, gamma=False).flat / 65535
        for n, seed in ((144, 1), (4, 2), (24, 3))
    )
    assert np.std(many - limit) < 0.03
    assert np.std(many - limit) < 0.6 * np.std(few - limit)


@pytest.mark.parametrize("focus", [0.35, -0.35])
def test_microlenses_are_sharpest_where_they_are_focused(focus: float) -> None:
    def contrast(wanted: float) -> float:
        camera = Camera.design((200, 200), 30.0, focus=wanted, fill=0.5)
        return float(
            np.median(
                simulate(SCENES["plane"](camera, ratio=focus), camera, samples=16).truth.contrast
            )
        )

    assert contrast(focus) > 1.15 * contrast(-focus)


def test_three_lens_types_blur_differently() -> None:
    camera = Camera.design((220, 220), 30.0, focus=(-0.35, 0.1, 0.4), fill=0.5)
    truth = simulate(SCENES["plane"](camera, ratio=-0.35), camera, samples=16).truth
    sharpness = [np.median(truth.contrast[truth.lens_type == k]) for k in range(3)]
    assert sharpness[0] > sharpness[1] > sharpness[2]


@pytest.mark.parametrize("name", sorted(SCENES))
def test_every_scene_fills_the_field_of_any_camera(name: str) -> None:
    camera = Camera.design((140, 120), 16.0, "square", 30.0)
    truth = simulate(SCENES[name](camera), camera, samples=2).truth
    assert np.isfinite(truth.patch_size).all()
    assert np.isfinite(truth.disparity).mean() > 0.6
    assert np.isfinite(truth.reference_patch_size).all()


def test_textureless_lenses_have_no_mode(small_camera: Camera) -> None:
    truth = simulate(SCENES["blank"](small_camera), small_camera, samples=8).truth
    centres = truth.calibration.lattice.centres()
    inner = ((centres > 15) & (centres < (245, 225))).all(1)
    assert (truth.mode[inner] == 0).all()
    assert np.isfinite(truth.patch_size).all()


@pytest.mark.parametrize(
    "bad",
    [
        {"samples": 0},
        {"bits": 12},
        {"seed": -1},
        {"noise": (0.0, 1.0)},
        {"noise": (100.0, float("nan"))},
    ],
)
def test_bad_arguments_are_named(small_camera: Camera, bad: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        simulate(SCENES["blank"](small_camera), small_camera, **bad)


def test_square_apertures_leave_dark_gaps_along_the_lattice() -> None:
    camera = Camera.design((200, 200), 24.0, "square", 7.0, microimage_fill=0.8).replace(
        square_aperture=True
    )
    capture = simulate(SCENES["blank"](camera), camera, samples=32, bits=16, gamma=False)
    index = camera.lattice.to_index(np.indices((200, 200))[::-1].reshape(2, -1).T)
    outside = (
        np.abs(index - np.rint(index)).max(1).reshape(200, 200) * camera.pitch
        - camera.microimage_radius
    )
    light = capture.white / 65535 / 0.9
    assert camera.microimage_radius == pytest.approx(0.4 * 24, rel=0.01)
    assert light[outside < -1.5].min() > 0.9
    assert light[outside > 1.5].max() == 0
    assert np.isnan(capture.truth.disparity[outside > 0.1]).all()
    assert np.isfinite(capture.truth.disparity[outside < -0.1]).all()


@pytest.mark.parametrize(("lattice", "shares"), [("hex", (1.0, 0.9, 0.8)), ("square", (1.0, 0.85))])
def test_lens_types_have_radii_of_their_own_and_stray_light_fills_gaps(
    lattice: str, shares: tuple[float, ...]
) -> None:
    camera = Camera.design((240, 240), 24.0, lattice, focus=(-0.45, -0.3, -0.2)[: len(shares)])
    camera = camera.replace(type_apertures=shares, stray=0.3, natural_vignetting=False)
    capture = simulate(SCENES["blank"](camera), camera, samples=32, bits=16, gamma=False)
    white = capture.white / 65535 / 0.9
    truth = capture.truth
    y, x = np.mgrid[:240, :240]
    centres = truth.calibration.lattice.centres()
    inner = (np.abs(centres - 119.5) < 80).all(1)
    assert white[40:-40, 40:-40].min() > 0.15
    for k, share in enumerate(shares):
        rims = [
            white[np.abs(np.hypot(x - u, y - v) - share * camera.microimage_radius) < 0.3]
            for u, v in centres[inner & (truth.lens_type == k)]
        ]
        assert np.concatenate(rims).mean() == pytest.approx(
            0.35 + 0.3 * white[40:-40, 40:-40].mean(), abs=0.05
        )


@pytest.mark.parametrize("mosaic", ["RGGB", "GBRG"])
def test_each_pixel_of_a_mosaic_sees_its_own_colour(small_camera: Camera, mosaic: str) -> None:
    scene = SCENES["clutter"](small_camera, seed=3)
    camera = small_camera.replace(filters=(0.8, 1.0, 0.6))
    whole, seen = (
        simulate(scene, one, samples=2) for one in (camera, camera.replace(mosaic=mosaic))
    )
    assert seen.truth.calibration.mosaic == mosaic
    assert np.array_equal(seen.truth.reference, whole.truth.reference)
    for place, colour in enumerate(mosaic):
        phase = np.s_[place // 2 :: 2, place % 2 :: 2]
        assert np.array_equal(seen.flat[phase], whole.flat[(*phase, "RGB".index(colour))])
    lit = whole.white > 250 * 0.9
    green = np.zeros_like(lit)
    for place in (k for k in range(4) if mosaic[k] == "G"):
        green[place // 2 :: 2, place % 2 :: 2] = True
    assert np.array_equal(seen.white[lit & green], whole.white[lit & green])
    assert seen.white[lit & ~green].max() < whole.white[lit].min()
