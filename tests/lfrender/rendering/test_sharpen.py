"""Sharpening undoes the blur of the microlenses, and not where noise exceeds the signal."""

from __future__ import annotations

import functools
import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import compare_pictures, resample
from lfrender.cli.main import main
from lfrender.rendering.sharpen import estimate_noise, power_spectrum, wiener_deconvolve

# Electrons of a full pixel and of read noise: about 1 % and 4 % of white at mid-grey.
LOW, HIGH = (2000, 5), (150, 5)


@functools.cache
def capture(scene, noise):
    camera = Camera.design(size=(360, 300), pitch=23.2, rotation=1.3)
    name, seed = (scene, None) if isinstance(scene, str) else scene
    drawn = SCENES[name](camera) if seed is None else SCENES[name](camera, seed=seed)
    return simulate(drawn, camera, samples=48, seed=3 if seed is None else seed, noise=noise)


@functools.cache
def depth_of(scene, noise):
    shot = capture(scene, noise)
    return lfrender.analyze(shot.flat, shot.truth.calibration)


def psnr(scene, noise, sharpen, **options):
    """[dB] against the traced reference, a pitch off the border."""
    shot = capture(scene, noise)
    truth = shot.truth
    if "patch_size" not in options:
        options["depth"] = depth_of(scene, noise)
    picture = lfrender.render(shot.flat, truth.calibration, sharpen=sharpen, detail="off", **options)
    wanted, inside = resample(truth.reference, truth.reference_affine, picture.image.shape[:2], picture.affine)
    border = int(np.ceil(picture.scale))
    inner = np.zeros(inside.shape, bool)
    inner[border:-border, border:-border] = True
    return compare_pictures(picture.image / 255.0, wanted, inside & inner & picture.valid).psnr


@pytest.mark.parametrize(("scene", "gain"), [("plane", 1.5), ("slope", 1.0)])
def test_pictures_with_little_noise_gain(scene, gain):
    assert psnr(scene, LOW, "auto") > psnr(scene, LOW, None) + gain


def test_pictures_of_clutter_with_little_noise_gain():
    # From scene to scene it is 0.06 to 0.3 dB: depth edges weigh more than sharpness.
    gains = [psnr(scene, LOW, "auto") - psnr(scene, LOW, None) for scene in (("clutter", k) for k in range(3, 9))]
    assert np.mean(gains) > 0.1
    assert min(gains) > 0


@pytest.mark.parametrize("scene", ["plane", "slope"])
def test_a_coarse_picture_is_not_sharpened_beyond_its_pixels(scene):
    assert psnr(scene, LOW, "auto", scale=0.15 * 23.2) > psnr(scene, LOW, None, scale=0.15 * 23.2) - 0.05


@pytest.mark.parametrize("scene", ["plane", "slope", "clutter"])
def test_pictures_with_much_noise_lose_nothing(scene):
    assert psnr(scene, HIGH, "auto") > psnr(scene, HIGH, None) - 0.01


def test_a_given_blur_width_is_undone_as_far_as_noise_allows():
    plain = psnr("plane", HIGH, None)
    assert psnr("plane", HIGH, 1.8) > plain
    assert psnr("plane", LOW, 1.8) - psnr("plane", LOW, None) > psnr("plane", HIGH, 1.8) - plain + 0.5


def test_a_picture_at_one_patch_size_is_sharpened_too():
    for blend in (False, True):
        options = {"patch_size": -0.3 * 23.2, "blend": blend}
        assert psnr("plane", LOW, "auto", **options) > psnr("plane", LOW, None, **options) + 0.5


@pytest.mark.parametrize("sigma", [0.8, 3.0, 12.0])
def test_the_noise_of_a_flat_is_measured_through_its_texture(sigma):
    shot = capture("plane", None)
    noisy = shot.flat.astype(np.float32) + np.random.default_rng(1).normal(0, sigma, shot.flat.shape)
    found = estimate_noise(noisy.astype(np.float32), shot.truth.calibration)
    # The simulator's own sampling noise is about 2.5 grey levels.
    own = estimate_noise(shot.flat.astype(np.float32), shot.truth.calibration)
    assert found == pytest.approx(np.hypot(sigma, own), rel=0.1)


def test_a_known_blur_is_undone_and_the_mean_kept():
    rng = np.random.default_rng(2)
    scene = cv2.GaussianBlur(rng.normal(100, 30, (300, 300)).astype(np.float32), (0, 0), 0.8)
    width = 2.5
    blurred = cv2.GaussianBlur(scene, (0, 0), width / 12**0.5)[..., None]
    sharp = wiener_deconvolve(blurred, width, np.zeros((64, 64)), np.ones(scene.shape, bool))
    error = [float(np.std((image[..., 0] - scene)[20:-20, 20:-20])) for image in (blurred, sharp)]
    assert error[1] < 0.4 * error[0]
    assert sharp.mean() == pytest.approx(blurred.mean(), rel=1e-3)


def test_pure_noise_is_not_amplified():
    noise = np.random.default_rng(3).normal(0, 5, (300, 300, 1)).astype(np.float32)
    out = wiener_deconvolve(noise, 3.0, power_spectrum(noise), np.ones((300, 300), bool))
    assert out.std() <= 1.02 * noise.std()


@pytest.mark.parametrize("sharpen", [-1.0, float("nan")])
def test_an_impossible_width_is_refused(sharpen):
    shot = capture("plane", LOW)
    with pytest.raises(ValueError, match="sharpen"):
        lfrender.render(shot.flat, shot.truth.calibration, patch_size=5.0, sharpen=sharpen)


def test_the_command_sharpens_and_says_so(tmp_path):
    shot = capture("plane", LOW)
    cv2.imwrite(str(tmp_path / "flat.png"), shot.flat[..., ::-1])
    shot.truth.calibration.save(tmp_path / "camera.json")
    common = ["render", str(tmp_path / "flat.png"), "-c", str(tmp_path / "camera.json")]
    pictures = []
    for name, extra in (("plain", ["--detail", "off"]), ("sharp", ["--sharpen", "auto"])):
        path = tmp_path / f"{name}.png"
        result = CliRunner().invoke(main, [*common, "-o", str(path), "--quiet", *extra])
        assert result.exit_code == 0, result.output
        with Image.open(path) as image:
            pictures.append(np.asarray(image, float))
            assert json.loads(image.info["Description"]).get("sharpen") == (extra[1] if name == "sharp" else None)
    assert np.abs(np.diff(pictures[1], axis=0)).mean() > 1.1 * np.abs(np.diff(pictures[0], axis=0)).mean()
    assert CliRunner().invoke(main, [*common, "-o", str(path), "--sharpen", "much"]).exit_code == 2
