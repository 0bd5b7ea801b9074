"""Pictures show no lattice pattern, and are as bright as the corrected flat."""

import dataclasses
import functools

import numpy as np
import pytest

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from lfcal.gain.gain_map import GainMap, Vignetting

SIZE = (520, 400)


@functools.cache
def capture(scene):
    camera = Camera.design(size=SIZE, pitch=23.2, rotation=1.3)
    return simulate(SCENES[scene](camera), camera, samples=32, seed=2)


def off_centre(lattice):
    """(H, W) distance [px] of each pixel from the centre of its microimage."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    points = np.stack([x, y], -1).reshape(-1, 2)
    centres = lattice.points(np.rint(lattice.to_index(points)))
    return np.hypot(*(points - centres).T).reshape(y.shape)


@functools.cache
def shaded_white():
    """A white image of lenses that lose half of the light toward their rim."""
    shot = capture("plane")
    distance = off_centre(shot.truth.calibration.lattice) / 11.6
    return np.rint(shot.white * (1 - 0.5 * np.minimum(distance, 1.2) ** 2)).astype(np.uint8)


@functools.cache
def camera_of(scene):
    white = shaded_white() if scene is None else capture(scene).white
    return lfcal.calibrate(white, kind="white")


def lattice_amplitude(picture, lattice):
    """RMS [grey levels] of the picture at frequencies of the lattice, up to the second order."""
    border = int(np.ceil(1.5 * picture.scale))
    image = picture.image.astype(float)
    image = image.mean(2) if image.ndim == 3 else image
    image = image[border:-border, border:-border]
    window = np.hanning(image.shape[0])[:, None] * np.hanning(image.shape[1])
    image = (image - image.mean()) * window
    spacing = picture.affine[0, 0]
    v, u = np.mgrid[: image.shape[0], : image.shape[1]] * spacing
    reciprocal = np.linalg.inv(lattice.basis).T
    power = 0.0
    for m in range(-2, 3):
        for n in range(-2, 3):
            k = np.array([m, n]) @ reciprocal
            # One of each pair of opposite frequencies, up to the finest that the picture holds.
            if (m, n) > (0, 0) and np.abs(k).max() * spacing < 0.5:
                amplitude = (
                    2
                    * abs((image * np.exp(-2j * np.pi * (k[0] * u + k[1] * v))).sum())
                    / window.sum()
                )
                power += amplitude**2 / 2
    return np.sqrt(power)


@pytest.mark.parametrize("s", [-12.0, -6.0, 6.0, 12.0])
@pytest.mark.parametrize("blend", [False, True])
def test_a_white_capture_gives_a_picture_without_lattice(s, blend):
    white = shaded_white()
    calibration = camera_of(None)
    picture = lfrender.render(white, calibration, patch_size=s, blend=blend)
    assert lattice_amplitude(picture, calibration.lattice) < 0.01 * picture.image.mean()


@functools.cache
def cut_camera():
    """A camera with mechanical vignetting (cat's eyes), and a white image of it."""
    lattice = Camera.design(size=SIZE, pitch=23.2, rotation=1.3).lattice
    round_lens = Vignetting(1 / (1 + np.exp(3 * (np.arange(0, 16, 0.25) - 11.2))), 0.25)
    # A second disc, 6 px aside in the corners, cuts microimages, and light falls off to exp(-0.4)
    # there.
    light = GainMap.round(
        round_lens.profile, round_lens.step, lattice.radius, [0.0, 0.0, 6.0, 11.2, 0.4]
    )
    light = dataclasses.replace(light, level=[0, 0, 0, -0.4, 0, -0.4])
    camera = lfcal.Calibration(lattice, round_lens, gain_map=light)
    return camera, np.rint(40000 * np.nan_to_num(camera.gain(), nan=0.05)).astype(np.uint16)


def unevenness(picture):
    border = int(np.ceil(picture.scale))
    inner = picture.image[border:-border, border:-border]
    return inner.std() / inner.mean()


CUT = {
    "crisp": lambda white, camera: lfrender.render(white, camera, patch_size=-8.0),
    "blended": lambda white, camera: lfrender.render(white, camera, patch_size=-8.0, blend=True),
    "blended, telescopic": lambda white, camera: lfrender.render(
        white, camera, patch_size=5.0, blend=True
    ),
    "refocused": lambda white, camera: lfrender.refocus(white, camera, -8.0),
    "traditional": lfrender.traditional,
}


@pytest.mark.parametrize("kind", CUT)
def test_mechanical_vignetting_and_a_dark_border_give_a_uniform_picture(kind):
    camera, white = cut_camera()
    assert unevenness(CUT[kind](white, camera)) < 0.003
    assert unevenness(CUT[kind](white, dataclasses.replace(camera, gain_map=None))) > 0.05


# Patch size of the plane that the ramp and the even scene lie on [px].
PLANE = -0.3 * 23.2
KINDS = {
    "all in focus": lambda flat, camera, depth: lfrender.render(
        flat, camera, depth, scale=abs(PLANE)
    ),
    "crisp": lambda flat, camera, depth: lfrender.render(flat, camera, patch_size=PLANE),
    "blended": lambda flat, camera, depth: lfrender.render(
        flat, camera, patch_size=PLANE, blend=True
    ),
    "refocused": lambda flat, camera, depth: lfrender.refocus(flat, camera, PLANE),
    "view": lambda flat, camera, depth: next(
        lfrender.views(flat, camera, depth, offsets=[(3.0, -5.0)], scale=abs(PLANE), still=PLANE)
    ),
    "traditional": lambda flat, camera, depth: lfrender.traditional(flat, camera),
}


@functools.cache
def depth_of(scene):
    flat = shaded_white() if scene is None else capture(scene).flat
    depth = lfrender.analyze(flat, camera_of(scene))
    # A uniform scene has no measurable depth: it is drawn on its true plane.
    surface = dataclasses.replace(
        depth.surface, patch_size=np.full_like(depth.surface.patch_size, PLANE)
    )
    return dataclasses.replace(depth, surface=surface) if scene is None else depth


def off_a_parabola(picture):
    """RMS [grey levels] of the residual from the smoothest surface through a picture, two pixels
    off the border.
    """
    image = picture.image.astype(float).reshape(*picture.image.shape[:2], -1).mean(2)[2:-2, 2:-2]
    v, u = np.mgrid[-1 : 1 : image.shape[0] * 1j, -1 : 1 : image.shape[1] * 1j]
    terms = np.stack([u**m * v**n for m in range(5) for n in range(5 - m)], -1).reshape(
        image.size, -1
    )
    return np.std(image.ravel() - terms @ np.linalg.lstsq(terms, image.ravel(), rcond=None)[0])


@pytest.mark.parametrize("kind", KINDS)
def test_a_smooth_ramp_shows_no_lattice_in_any_picture(kind):
    camera = camera_of("ramp")
    # As floats: rounding to integers alone is one per cent.
    picture = KINDS[kind](capture("ramp").flat / np.float32(255), camera, depth_of("ramp"))
    if kind == "traditional":
        # The lattice is finer than its pixels, and would show as a beat.
        assert off_a_parabola(picture) < 0.01 * picture.image.std()
    else:
        assert lattice_amplitude(picture, camera.lattice) < 0.01 * picture.image.std()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scene", ["ramp", None])
def test_every_picture_is_as_bright_as_the_corrected_flat(kind, scene):
    flat = shaded_white() if scene is None else capture(scene).flat
    camera = camera_of(scene)
    picture = KINDS[kind](flat, camera, depth_of(scene))
    known = np.isfinite(camera.gain()) & (off_centre(camera.lattice) < 0.4 * camera.lattice.pitch)
    assert picture.image[picture.valid].mean() == pytest.approx(
        camera.flatten(flat)[known].mean(), rel=0.01
    )


@pytest.mark.parametrize("kind", ["view", "all in focus", "traditional"])
def test_a_white_capture_gives_views_and_lens_means_without_lattice(kind):
    camera = camera_of(None)
    picture = KINDS[kind](shaded_white(), camera, depth_of(None))
    assert off_a_parabola(picture) < 0.01 * picture.image.mean()
